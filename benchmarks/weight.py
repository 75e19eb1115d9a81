"""What the package weighs: files, lines, lines of code, functions, classes and named numbers, room by room.

    python benchmarks/weight.py odomcorrupt tests --against weight.toml

A room is a folder directly below the first argument; every argument is weighed as a whole too. A *line of code* holds
something other than a comment or a docstring. A *named number* is an UPPERCASE name of a module or a class, or a field
with a default, whose value contains a number other than 0, 1, -1 or 2. With `--against`, what is heavier than its
budget is listed, and the exit code is 1.
"""

import argparse
import ast
import io
import sys
import tokenize
import tomllib
from collections import Counter
from pathlib import Path

COLUMNS = ("files", "lines", "code", "functions", "classes", "numbers")
PLAIN = (0, 1, -1, 2)
LAYOUT = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


def code_lines(text: str, nodes: list[ast.AST]) -> int:
    """Lines with at least one token that is neither comment nor docstring."""
    holders = [node for node in nodes if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)]
    docstrings = [node.body[0] for node in holders if ast.get_docstring(node) is not None]
    silent = {line for doc in docstrings for line in range(doc.lineno, (doc.end_lineno or doc.lineno) + 1)}
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    spoken = (range(token.start[0], token.end[0] + 1) for token in tokens if token.type not in LAYOUT)
    return len({line for lines in spoken for line in lines} - silent)


def is_number(node: ast.AST) -> bool:
    """Whether a literal is a number that needs a reason."""
    return isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in PLAIN


def is_named_number(node: ast.stmt, scope: ast.Module | ast.ClassDef) -> bool:
    """Whether a statement of a module or a class gives a number a name."""
    target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
    value = getattr(node, "value", None)
    if not isinstance(node, ast.Assign | ast.AnnAssign) or not isinstance(target, ast.Name) or value is None:
        return False
    if isinstance(scope, ast.ClassDef) and isinstance(node, ast.AnnAssign) and is_number(value):
        return True
    return target.id.lstrip("_").isupper() and any(is_number(part) for part in ast.walk(value))


def weight_of(text: str) -> Counter[str]:
    """Weight of one file."""
    nodes = list(ast.walk(ast.parse(text)))
    scopes = [node for node in nodes if isinstance(node, ast.Module | ast.ClassDef)]
    return Counter(
        files=1,
        lines=text.count("\n"),
        code=code_lines(text, nodes),
        functions=sum(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in nodes),
        classes=sum(isinstance(node, ast.ClassDef) for node in nodes),
        numbers=sum(is_named_number(node, scope) for scope in scopes for node in scope.body),
    )


def weigh(folders: list[Path]) -> dict[str, Counter[str]]:
    """Weight of each folder and, under its own name, of each room of the first."""
    rooms: dict[str, Counter[str]] = {folder.name: Counter() for folder in folders}
    for folder in folders:
        for path in sorted(folder.rglob("*.py")):
            weight = weight_of(path.read_text(encoding="utf-8"))
            rooms[folder.name].update(weight)
            if folder == folders[0]:
                inside = path.relative_to(folder).parts
                rooms.setdefault(inside[0] if len(inside) > 1 else "(top)", Counter()).update(weight)
    return rooms


def main() -> int:
    """Print the weights; 1 if a room is heavier than its budget."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--against", type=Path, metavar="BUDGET.toml")
    asked = parser.parse_args()
    rooms = weigh(asked.folders)
    print(f"{'room':16}" + "".join(f"{column:>11}" for column in COLUMNS))
    for room, weight in sorted(rooms.items(), key=lambda item: -item[1]["code"]):
        print(f"{room:16}" + "".join(f"{weight[column]:11}" for column in COLUMNS))
    budget = tomllib.loads(asked.against.read_text(encoding="utf-8")) if asked.against else {}
    heavier = [
        f"too heavy: {room} has {rooms[room][what]} {what}, its budget is {limit}"
        for room, limits in budget.items()
        for what, limit in limits.items()
        if rooms.get(room, Counter())[what] > limit
    ]
    print("\n".join(heavier), file=sys.stderr, end="\n" if heavier else "")
    return 1 if heavier else 0


if __name__ == "__main__":
    sys.exit(main())

"use strict";
// The interactive part of a report: the path with zoom and pan, the residuals along it, the error by distance.
// Everything drawn is in the JSON beside it (described in explorer.py); without scripts the page shows its pictures only.
(() => {
  const data = JSON.parse(document.getElementById("explorer-data").textContent);
  const root = document.getElementById("explorer");
  const SVG = "http://www.w3.org/2000/svg";
  const DEG = 180 / Math.PI;
  const CHANNELS = ["along (m)", "across (m)", "yaw (deg)", "size of whitened residuals"];
  const last = data.models.length - 1;
  const state = {
    piece: 0, models: new Set([0, last]), horizons: new Set(data.lengths), channel: 2, restart: 0, look: null, at: null,
    layers: { truth: true, runs: true, measured: true, corrected: false },
    view: null,
  };

  // ---- building blocks
  function svg(tag, attributes, parent, text) {
    const made = document.createElementNS(SVG, tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  }
  function html(tag, attributes, parent, text) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (text !== undefined) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  }
  const colour = (m) => `var(--model-${m % 6})`;
  const wrap = (angle) => Math.atan2(Math.sin(angle), Math.cos(angle));
  function metres(value) {
    if (!Number.isFinite(value)) return "–";
    return Math.abs(value) >= 1 ? `${value.toFixed(2)} m` : `${(1000 * value).toPrecision(3)} mm`;
  }
  function shown(value, channel) {
    if (value === null) return "–";
    if (channel === 2) return `${value.toFixed(2)} deg`;
    return channel === 3 ? value.toFixed(2) : metres(value);
  }
  function ticks(low, high, most) {
    const raw = Math.max(high - low, 1e-12) / most;
    const power = 10 ** Math.floor(Math.log10(raw));
    const step = power * [1, 2, 5, 10].find((f) => f * power >= raw);
    const found = [];
    for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k += 1) found.push(+(k * step).toPrecision(12));
    return found;
  }
  // an SVG path through points, lifted at the gaps and where a value is missing
  function line(xs, ys, from, to, gaps) {
    let d = "";
    let pen = false;
    for (let i = from; i <= to; i += 1) {
      if (xs[i] === null || ys[i] === null) { pen = false; continue; }
      d += `${pen && !gaps.has(i) ? "L" : "M"}${xs[i]} ${ys[i]}`;
      pen = true;
    }
    return d;
  }
  // odometry x, y: anchored once at its first pose, or again at the truth after every `every` metres
  function anchored(truth, poses, distance, every, gaps) {
    const xs = [], ys = [], breaks = new Set(gaps);
    let from = 0;
    for (let i = 0; i < truth.x.length; i += 1) {
      if (i && (gaps.has(i) || (every && distance[i] - distance[from] >= every))) {
        if (every) { from = i; breaks.add(i); }
      }
      const a = truth.yaw[from] - poses.yaw[from];
      const dx = poses.x[i] - poses.x[from], dy = poses.y[i] - poses.y[from];
      xs.push(truth.x[from] + Math.cos(a) * dx - Math.sin(a) * dy);
      ys.push(truth.y[from] + Math.sin(a) * dx + Math.cos(a) * dy);
    }
    return { xs, ys, breaks };
  }

  // ---- the controls
  function group(title) {
    const box = html("fieldset", {}, html("div", { class: "group" }, controls));
    html("legend", {}, box, title);
    return box;
  }
  function check(box, text, on, change, swatch) {
    const label = html("label", {}, box);
    const input = html("input", { type: "checkbox" }, label);
    input.checked = on;
    input.addEventListener("change", () => { change(input.checked); draw(); });
    if (swatch) html("span", { class: "swatch", style: `background:${swatch}` }, label);
    html("span", {}, label, text);
    return input;
  }
  function choice(box, name, options, value, change) {
    const label = html("label", {}, box);
    html("span", {}, label, name);
    const select = html("select", { "aria-label": name }, label);
    for (const [key, text] of options) html("option", { value: key }, select, text);
    select.value = value;
    select.addEventListener("change", () => { change(select.value); draw(); });
    return select;
  }
  const put = (set, value, on) => { if (on) set.add(value); else set.delete(value); };

  root.hidden = false;
  const controls = html("div", { class: "controls" }, root);
  const models = group("Models");
  const modelInputs = data.models.map((m, i) =>
    check(models, m.name, state.models.has(i), (on) => put(state.models, i, on), colour(i)));
  const what = group("Path");
  let pieceSelect = null;
  if (data.pieces.length > 1) {
    const options = data.pieces.map((p, i) => [i, `${p.name}, ${p.length_m} m`]);
    pieceSelect = choice(what, "stretch", options, 0, (v) => { state.piece = +v; state.view = null; state.at = null; });
  }
  check(what, "truth", true, (on) => { state.layers.truth = on; }, "var(--ink)");
  check(what, "runs of the models", true, (on) => { state.layers.runs = on; });
  check(what, "odometry as recorded", true, (on) => { state.layers.measured = on; }, "var(--measured)");
  check(what, "odometry, effects removed", false, (on) => { state.layers.corrected = on; });
  const restarts = [[0, "once, at the beginning"], ...data.lengths.map((d) => [d, `every ${d} m`])];
  const restartSelect = choice(what, "odometry starts at the truth", restarts, 0, (v) => { state.restart = +v; });
  const lengths = group("Horizons");
  for (const d of data.lengths) check(lengths, `${d} m`, true, (on) => put(state.horizons, d, on));

  function panel(name, title, hint, height) {
    const box = html("div", { class: "panel" }, root);
    const head = html("div", { class: "panel-head" }, box);
    html("h3", {}, head, title);
    const buttons = html("div", { class: "buttons" }, head);
    const image = svg("svg", { id: name, role: "img", "aria-label": title, tabindex: "0" }, box);
    image.style.height = height;
    html("p", { class: "quiet" }, box, hint);
    return { box, buttons, image };
  }
  const plane = panel("plane", "Path", "Point at the path for values; drag to move it; zoom with the buttons, two " +
    "fingers, or the wheel after a click. A sentence of a list above or below, clicked, marks its stretches here.",
  "min(62vh, 34rem)");
  const strip = panel("strip", "Residuals", "Odometry minus truth, effects of the model removed, summed from the " +
    "beginning: a slope is a steady error, a step a sudden one. Whitened residuals are 1 where errors are as expected.",
  "15rem");
  const curve = panel("curve", "Error by length of path", "Root mean square of the position error after a length of " +
    "path. Dashed: expected by the model; bars: 90 % interval of the measured value, by the number of windows.",
  "17rem");
  choice(strip.buttons, "show", CHANNELS.map((c, i) => [i, c]), 2, (v) => { state.channel = +v; });
  const tip = html("div", { class: "tip", role: "status" }, root);
  tip.hidden = true;
  for (const [text, name, act] of [["+", "zoom in", () => zoom(1.5)], ["−", "zoom out", () => zoom(1 / 1.5)],
    ["all", "show all", () => { state.view = null; draw(); }]]) {
    html("button", { type: "button", "aria-label": name }, plane.buttons, text).addEventListener("click", act);
  }

  // ---- the path
  const size = (image) => [Math.max(image.clientWidth, 50), Math.max(image.clientHeight, 50)];
  function fitted(piece) {
    const [w, h] = size(plane.image);
    const xs = [...piece.truth.x, ...piece.measured.x.map((_, i) => base(piece).xs[i])];
    const ys = [...piece.truth.y, ...piece.measured.y.map((_, i) => base(piece).ys[i])];
    const [x0, x1, y0, y1] = [min(xs), max(xs), min(ys), max(ys)];
    const scale = Math.min((w - 60) / Math.max(x1 - x0, 0.1), (h - 50) / Math.max(y1 - y0, 0.1));
    return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, scale };
  }
  const min = (xs) => xs.reduce((a, b) => (b < a ? b : a), Infinity);
  const max = (xs) => xs.reduce((a, b) => (b > a ? b : a), -Infinity);
  function base(piece) {
    if (!piece.base) piece.base = anchored(piece.truth, piece.measured, piece.d, 0, piece.gapSet);
    return piece.base;
  }
  const screen = (x, y) => {
    const [w, h] = size(plane.image);
    return [w / 2 + (x - state.view.x) * state.view.scale, h / 2 - (y - state.view.y) * state.view.scale];
  };
  const world = (px, py) => {
    const [w, h] = size(plane.image);
    return [state.view.x + (px - w / 2) / state.view.scale, state.view.y - (py - h / 2) / state.view.scale];
  };
  function spans() {
    if (!state.look) return [];
    return data.models[state.look[0]].failures[state.look[1]].spans.filter((s) => s[0] === state.piece);
  }
  function drawPlane() {
    const piece = data.pieces[state.piece];
    if (!state.view) state.view = fitted(piece);
    const { image } = plane;
    const [w, h] = size(image);
    image.replaceChildren();
    const [left, top] = world(0, 0), [right, bottom] = world(w, h);
    for (const x of ticks(left, right, Math.max(w / 110, 2))) {
      const px = screen(x, 0)[0];
      svg("line", { x1: px, x2: px, y1: 0, y2: h, class: "grid" }, image);
      if (px > 24) svg("text", { x: px + 3, y: h - 4 }, image, `${x} m`);
    }
    for (const y of ticks(bottom, top, Math.max(h / 90, 2))) {
      const py = screen(0, y)[1];
      svg("line", { x1: 0, x2: w, y1: py, y2: py, class: "grid" }, image);
      if (py < h - 18) svg("text", { x: 3, y: py - 3 }, image, `${y} m`);
    }
    const [tx, ty] = screen(0, 0), s = state.view.scale;
    const g = svg("g", { transform: `matrix(${s} 0 0 ${-s} ${tx} ${ty})` }, image);
    const stroke = (d, cls, c) => svg("path", { d, class: cls, style: c ? `stroke:${c}` : "" }, g);
    const end = piece.truth.x.length - 1;
    for (const [, i0, i1] of spans()) {
      stroke(line(piece.truth.x, piece.truth.y, i0, Math.min(i1 + 1, end), piece.gapSet), "mark");
    }
    if (state.layers.runs) {
      for (const m of state.models) {
        for (const run of data.models[m].pieces[state.piece].runs) {
          stroke(line(run[0], run[1], 0, run[0].length - 1, new Set()), "run", colour(m));
        }
      }
    }
    if (state.layers.truth) stroke(line(piece.truth.x, piece.truth.y, 0, end, piece.gapSet), "truth");
    const odometry = (poses, cls, c) => {
      const a = anchored(piece.truth, poses, piece.d, state.restart, piece.gapSet);
      stroke(line(a.xs, a.ys, 0, end, a.breaks), cls, c);
    };
    if (state.layers.measured) odometry(piece.measured, "odometry", "var(--measured)");
    if (state.layers.corrected) {
      for (const m of state.models) odometry(data.models[m].pieces[state.piece].corrected, "corrected", colour(m));
    }
    const [bx, by] = screen(piece.truth.x[0], piece.truth.y[0]);
    svg("rect", { x: bx - 4, y: by - 4, width: 8, height: 8, class: "start" }, image);
    const place = state.look && spans().length && data.models[state.look[0]].failures[state.look[1]].place;
    if (place) {
      const [cx, cy] = screen(place[0], place[1]);
      svg("circle", { cx, cy, r: Math.max(place[2] * s, 9), class: "place" }, image);
    }
    if (state.at !== null) {
      const [cx, cy] = screen(piece.truth.x[state.at], piece.truth.y[state.at]);
      svg("circle", { cx, cy, r: 6, class: "here" }, image);
    }
  }
  function zoom(factor, px, py) {
    const [w, h] = size(plane.image);
    const [x, y] = world(px ?? w / 2, py ?? h / 2);
    const scale = Math.min(Math.max(state.view.scale * factor, 1e-3), 1e5);
    const k = state.view.scale / scale;
    state.view = { x: x + (state.view.x - x) * k, y: y + (state.view.y - y) * k, scale };
    drawPlane();
  }

  // ---- the residuals along the drive
  const MARGIN = { left: 58, right: 12, top: 10, bottom: 34 };
  function frame(image, xt, yt, toX, toY, xLabel) {
    const [w, h] = size(image);
    image.replaceChildren();
    for (const [value, text] of xt) {
      svg("line", { x1: toX(value), x2: toX(value), y1: MARGIN.top, y2: h - MARGIN.bottom, class: "grid" }, image);
      svg("text", { x: toX(value), y: h - MARGIN.bottom + 14, "text-anchor": "middle" }, image, text);
    }
    for (const [value, text] of yt) {
      svg("line", { x1: MARGIN.left, x2: w - MARGIN.right, y1: toY(value), y2: toY(value), class: "grid" }, image);
      svg("text", { x: MARGIN.left - 6, y: toY(value) + 4, "text-anchor": "end" }, image, text);
    }
    svg("text", { x: w - MARGIN.right, y: h - 4, "text-anchor": "end" }, image, xLabel);
  }
  function axis(low, high, from, to) { return (v) => from + ((v - low) / Math.max(high - low, 1e-12)) * (to - from); }
  function drawStrip() {
    const piece = data.pieces[state.piece], { image } = strip;
    const [w, h] = size(image);
    const series = [...state.models].map((m) => [m, data.models[m].pieces[state.piece].residuals[state.channel]]);
    const every = series.flatMap(([, values]) => values.filter((v) => v !== null));
    const [low, high] = [Math.min(0, min(every)), Math.max(1e-9, max(every))];
    const t0 = piece.t[0], t1 = piece.t[piece.t.length - 1];
    const toX = axis(t0, t1, MARGIN.left, w - MARGIN.right);
    const toY = axis(low, high, h - MARGIN.bottom, MARGIN.top);
    const named = (v) => [v, `${v}`];
    frame(image, ticks(t0, t1, w / 90).map(named), ticks(low, high, 5).map(named), toX, toY, "time (s)");
    for (const [, i0, i1] of spans()) {
      const x0 = toX(piece.t[i0]), x1 = toX(piece.t[Math.min(i1 + 1, piece.t.length - 1)]);
      svg("rect", { x: x0, y: MARGIN.top, width: Math.max(x1 - x0, 2), height: h - MARGIN.bottom - MARGIN.top,
        class: "span" }, image);
    }
    for (const [m, values] of series) {
      const d = line(piece.t.map(toX), values.map((v) => (v === null ? null : toY(v))), 0, values.length - 1, new Set());
      svg("path", { d, class: "curve", style: `stroke:${colour(m)}` }, image);
    }
    if (state.at !== null) {
      const x = toX(piece.t[state.at]);
      svg("line", { x1: x, x2: x, y1: MARGIN.top, y2: h - MARGIN.bottom, class: "cursor" }, image);
    }
    strip.index = (px) => {
      const t = t0 + ((px - MARGIN.left) / (w - MARGIN.right - MARGIN.left)) * (t1 - t0);
      return nearest(piece.t.map((v) => Math.abs(v - t)));
    };
  }
  const nearest = (values) => values.reduce((best, v, i) => (v < values[best] ? i : best), 0);

  // ---- the error by length of path
  let dots = [];
  function drawCurve() {
    const { image } = curve;
    const [w, h] = size(image);
    const rows = [...state.models].map((m) => [m, data.models[m].horizons.filter((r) => state.horizons.has(r.length))]);
    const values = rows.flatMap(([, rs]) => rs.flatMap((r) => [r.measured, r.expected, r.low, r.high]))
      .filter((v) => v > 0);
    const ds = rows.flatMap(([, rs]) => rs.map((r) => r.length));
    dots = [];
    image.replaceChildren();
    if (!values.length) { svg("text", { x: 12, y: 24 }, image, "no model or no horizon is chosen"); return; }
    const log = Math.log10;
    const toX = (d) => axis(log(min(ds)) - 0.1, log(max(ds)) + 0.1, MARGIN.left, w - MARGIN.right)(log(d));
    const toY = (v) => axis(log(min(values)) - 0.05, log(max(values)) + 0.05, h - MARGIN.bottom, MARGIN.top)(log(v));
    const yt = [];
    for (let e = Math.floor(log(min(values))) - 1; e <= log(max(values)); e += 1) {
      for (const f of [1, 2, 5]) {
        const v = f * 10 ** e;
        if (toY(v) <= h - MARGIN.bottom && toY(v) >= MARGIN.top) yt.push([v, metres(v)]);
      }
    }
    frame(image, [...new Set(ds)].map((d) => [d, `${d}`]), yt, toX, toY, "path driven (m)");
    for (const [m, rs] of rows) {
      const xs = rs.map((r) => toX(r.length)), c = `stroke:${colour(m)}`, gone = new Set();
      svg("path", { d: line(xs, rs.map((r) => toY(r.expected)), 0, rs.length - 1, gone), class: "expected", style: c }, image);
      svg("path", { d: line(xs, rs.map((r) => toY(r.measured)), 0, rs.length - 1, gone), class: "curve", style: c }, image);
      rs.forEach((r, i) => {
        svg("line", { x1: xs[i], x2: xs[i], y1: toY(r.low), y2: toY(r.high), class: "bar-of", style: c }, image);
        svg("circle", { cx: xs[i], cy: toY(r.measured), r: 4, style: `fill:${colour(m)}` }, image);
        dots.push([xs[i], toY(r.measured), m, r]);
      });
    }
  }

  // ---- pointing, dragging, zooming
  function tell(event, lines) {
    tip.replaceChildren();
    for (const text of lines) html("div", {}, tip, text);
    tip.hidden = false;
    const box = root.getBoundingClientRect();
    const x = Math.min(event.clientX - box.left + 14, box.width - tip.offsetWidth - 4);
    const above = event.clientY - tip.offsetHeight - 12;
    tip.style.left = `${Math.max(x, 0)}px`;
    tip.style.top = `${(above > 0 ? above : event.clientY + 16) - box.top}px`;
  }
  function silence() { tip.hidden = true; if (state.at !== null) { state.at = null; drawPlane(); drawStrip(); } }
  function pointAt(event, i) {
    const piece = data.pieces[state.piece], { truth } = piece;
    state.at = i;
    drawPlane(); drawStrip();
    const off = (poses) => {
      const a = anchored(truth, poses, piece.d, state.restart, piece.gapSet);
      return metres(Math.hypot(a.xs[i] - truth.x[i], a.ys[i] - truth.y[i]));
    };
    const lines = [`${piece.t[i].toFixed(1)} s, ${piece.d[i].toFixed(2)} m driven`,
      `truth ${truth.x[i].toFixed(2)}, ${truth.y[i].toFixed(2)} m, ${(DEG * wrap(truth.yaw[i])).toFixed(1)} deg`,
      `${piece.v[i].toFixed(2)} m/s, ${(DEG * piece.w[i]).toFixed(1)} deg/s`, `odometry off by ${off(piece.measured)}`];
    for (const m of state.models) {
      const own = data.models[m].pieces[state.piece];
      lines.push(`${data.models[m].name}: ${off(own.corrected)} with its effects removed; residuals, ` +
        `${CHANNELS[state.channel].split(" (")[0]}: ${shown(own.residuals[state.channel][i], state.channel)}`);
    }
    tell(event, lines);
  }
  const inside = (image, event) => {
    const box = image.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const fingers = new Map();
  plane.image.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, inside(plane.image, event));
    plane.image.setPointerCapture(event.pointerId);
  });
  for (const kind of ["pointerup", "pointercancel"]) {
    plane.image.addEventListener(kind, (event) => fingers.delete(event.pointerId));
  }
  plane.image.addEventListener("pointermove", (event) => {
    const now = inside(plane.image, event), before = fingers.get(event.pointerId);
    if (before && fingers.size === 1) {
      state.view.x -= (now[0] - before[0]) / state.view.scale;
      state.view.y += (now[1] - before[1]) / state.view.scale;
      fingers.set(event.pointerId, now);
      drawPlane();
      return;
    }
    if (before && fingers.size === 2) {
      const other = [...fingers].find(([id]) => id !== event.pointerId)[1];
      const span = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      fingers.set(event.pointerId, now);
      zoom(span(now) / span(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      return;
    }
    const { truth } = data.pieces[state.piece];
    const far = truth.x.map((x, i) => { const p = screen(x, truth.y[i]); return Math.hypot(p[0] - now[0], p[1] - now[1]); });
    const i = nearest(far);
    if (far[i] < 40) pointAt(event, i); else silence();
  });
  plane.image.addEventListener("click", (event) => {
    const { truth } = data.pieces[state.piece], now = inside(plane.image, event);
    const far = truth.x.map((x, i) => { const p = screen(x, truth.y[i]); return Math.hypot(p[0] - now[0], p[1] - now[1]); });
    if (far[nearest(far)] < 40) pointAt(event, nearest(far));
  });
  plane.image.addEventListener("pointerleave", silence);
  plane.image.addEventListener("wheel", (event) => {
    if (document.activeElement !== plane.image && !event.ctrlKey) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), ...inside(plane.image, event));
  }, { passive: false });
  plane.image.addEventListener("keydown", (event) => {
    const step = 60 / state.view.scale;
    const act = { "+": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: () => { state.view = null; },
      ArrowLeft: () => { state.view.x -= step; }, ArrowRight: () => { state.view.x += step; },
      ArrowUp: () => { state.view.y += step; }, ArrowDown: () => { state.view.y -= step; } }[event.key];
    if (act) { event.preventDefault(); act(); drawPlane(); }
  });
  for (const kind of ["pointermove", "click"]) {
    strip.image.addEventListener(kind, (event) => pointAt(event, strip.index(inside(strip.image, event)[0])));
    curve.image.addEventListener(kind, (event) => {
      const [x, y] = inside(curve.image, event);
      const i = dots.length ? nearest(dots.map((d) => Math.hypot(d[0] - x, d[1] - y))) : 0;
      if (!dots.length || Math.hypot(dots[i][0] - x, dots[i][1] - y) > 40) { tip.hidden = true; return; }
      const [, , m, r] = dots[i];
      tell(event, [data.models[m].name, `${metres(r.measured)} after ${r.length} m (${r.windows} windows)`,
        `expected ${metres(r.expected)}; NEES ${r.nees.toFixed(2)}`]);
    });
  }
  strip.image.addEventListener("pointerleave", silence);
  curve.image.addEventListener("pointerleave", silence);

  // ---- sentences that highlight their places
  const sentences = [...document.querySelectorAll("[data-look]")];
  function choose(item) {
    const [m, f] = item.dataset.look.split(",").map(Number);
    const again = state.look && state.look[0] === m && state.look[1] === f;
    state.look = again ? null : [m, f];
    for (const other of sentences) other.setAttribute("aria-pressed", `${other === item && !again}`);
    if (!again) {
      const failure = data.models[m].failures[f];
      state.models.add(m);
      modelInputs[m].checked = true;
      if (failure.channel !== null) {
        state.channel = failure.channel;
        strip.buttons.querySelector("select").value = failure.channel;
      }
      if (failure.length) { state.restart = failure.length; restartSelect.value = failure.length; }
      if (failure.spans.length && !failure.spans.some((s) => s[0] === state.piece)) {
        state.piece = failure.spans[0][0];
        state.view = null;
        if (pieceSelect) pieceSelect.value = state.piece;
      }
      plane.box.scrollIntoView({ block: "start", behavior: "auto" });
    }
    draw();
  }
  for (const item of sentences) {
    item.setAttribute("role", "button");
    item.setAttribute("tabindex", "0");
    item.setAttribute("aria-pressed", "false");
    item.addEventListener("click", () => choose(item));
    item.addEventListener("keydown", (event) => {
      if (event.key === "Enter" || event.key === " ") { event.preventDefault(); choose(item); }
    });
  }

  function draw() {
    drawPlane(); drawStrip(); drawCurve();
    for (const box of document.querySelectorAll("[data-model]")) {
      box.hidden = !state.models.has(+box.dataset.model);
      for (const row of box.querySelectorAll("tbody tr")) {
        const length = parseFloat(row.cells[0].textContent);
        row.hidden = data.lengths.includes(length) && !state.horizons.has(length);
      }
    }
  }
  for (const piece of data.pieces) piece.gapSet = new Set(piece.gaps);
  let width = 0;
  new ResizeObserver(() => {
    if (root.clientWidth === width) return;
    width = root.clientWidth;
    state.view = null;
    draw();
  }).observe(root);
  draw();
})();

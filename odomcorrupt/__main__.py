"""`python -m odomcorrupt` is the console script."""

from odomcorrupt.cli import main

if __name__ == "__main__":
    main()

"""The command line, as `python -m kempe`."""

from kempe.cli import main

if __name__ == "__main__":
    main()

"""The command `atmofit`, also as `python -m atmofit`; says what is missing where something is."""

import sys


def main() -> int:
    """Run the command line; 2 after one line where it is not installed."""
    try:
        from atmofit.cli import main as run
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] == "atmofit":
            raise
        hint = "pip install 'atmofit[cli]'"
        print(f"atmofit: the command line needs {error.name}: {hint}", file=sys.stderr)
        return 2
    return run()


if __name__ == "__main__":
    sys.exit(main())

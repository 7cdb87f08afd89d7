"""``python -m labhil``: the same as the command ``labhil``."""

from labhil.cli import main

if __name__ == "__main__":
    main()

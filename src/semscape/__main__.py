"""`python -m semscape` is the command `semscape`."""

from semscape.cli import main

if __name__ == "__main__":
    main()

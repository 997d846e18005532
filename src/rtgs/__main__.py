"""`python -m rtgs` is the command `rtgs`."""

from rtgs.cli import main

if __name__ == "__main__":
    main()

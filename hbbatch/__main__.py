"""`python -m hbbatch` is the same command as `hbbatch`."""

from hbbatch.cli.main import main

if __name__ == "__main__":
    main()

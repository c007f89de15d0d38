"""`python -m hbbatch` is the same command as `hbbatch`."""


def main() -> None:
    """Run the command line.

    It is imported here and not above because worker processes import this module as they start.
    """
    from hbbatch.cli.main import main as run

    run()


if __name__ == "__main__":
    main()

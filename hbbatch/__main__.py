"""`python -m hbbatch` is the same command as `hbbatch`."""

import signal


def main() -> None:
    """Run the command line.

    It is imported here and not above because worker processes import this module as they start.
    """
    # Ctrl-C needs no handling, and no traceback, while there is nothing to interrupt yet.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from hbbatch.cli.main import main as run

    run()


if __name__ == "__main__":
    main()

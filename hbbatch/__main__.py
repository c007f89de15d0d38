"""`python -m hbbatch` is the same command as `hbbatch`."""

import signal


def main() -> None:
    """Run the command line.

    It is imported here and not above because worker processes import this module as they start.
    """
    heeds = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if heeds:  # while there is nothing to interrupt yet, without a word
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from hbbatch.cli.main import main as run

    if heeds:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


if __name__ == "__main__":
    main()

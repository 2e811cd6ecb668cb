"""The command ``mdm``, also as ``python -m mdm``."""

from __future__ import annotations

import signal
import sys

__all__ = ["main"]


def main() -> int:
    """Run the command; return its exit status.

    Until it has been imported Ctrl-C ends the process at once, without a word.
    """
    interrupt = signal.getsignal(signal.SIGINT)
    if interrupt is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        from mdm.cli import main as command  # noqa: PLC0415 - while this is imported, Ctrl-C is no exception

        signal.signal(signal.SIGINT, interrupt)
        return command()
    except KeyboardInterrupt:
        return 130
    finally:
        if (
            signal.getsignal(signal.SIGINT) is signal.default_int_handler
        ):  # a signal that ends a robot is still listened to
            signal.signal(signal.SIGINT, signal.SIG_DFL)  # there is nothing left to do but to end


if __name__ == "__main__":
    sys.exit(main())

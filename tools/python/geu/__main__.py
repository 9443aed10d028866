"""The command: `python -m geu`, and `geu` where the package is installed."""

import signal
import sys

from geu._geu import command


def main() -> None:
    # The command ends at Ctrl-C as any other does; Python's handler would wait for its return.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(command(["geu", *sys.argv[1:]]))


if __name__ == "__main__":
    main()

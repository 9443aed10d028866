"""The command: `python -m geu`, and `geu` where the package is installed."""

import os
import signal
import sys
import threading

from geu._geu import command
from geu._run import ENDS_WITH_INPUT


def end_with_input() -> None:
    """Ends this process when the one at the other end of standard input does."""
    while os.read(0, 1024):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> None:
    # The command ends at Ctrl-C as any other does; Python's handler would wait for its return.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    if os.environ.pop(ENDS_WITH_INPUT, None):
        threading.Thread(target=end_with_input, daemon=True).start()
    sys.exit(command(["geu", *sys.argv[1:]]))


if __name__ == "__main__":
    main()

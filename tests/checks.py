"""One line per check, and a closing count: `N passed, N failed, N skipped`."""
import sys


class Checks:
    def __init__(self):
        self.passed = self.failed = self.skipped = 0

    def check(self, name, good, detail=""):
        """Counts and prints; `detail` is shown when it failed. Returns whether it passed."""
        self.passed += bool(good)
        self.failed += not good
        if good:
            print(f"ok: {name}", flush=True)
        else:
            print(f"FAILED: {name}" + (f": {detail}" if detail else ""), flush=True)
        return bool(good)

    def equal(self, name, got, expected):
        """Passes when both are equal; of two lists it shows the first difference."""
        detail = f"expected {expected!r}, got {got!r}"
        if isinstance(got, list) and isinstance(expected, list) and len(got) + len(expected) > 8:
            at = next((i for i, (a, b) in enumerate(zip(got, expected)) if a != b), min(len(got), len(expected)))
            detail = (f"{len(got)} against {len(expected)} expected; first difference at {at}: "
                      f"expected {expected[at:at + 1]}, got {got[at:at + 1]}")
        return self.check(name, got == expected, detail)

    def skip(self, name, reason):
        self.skipped += 1
        print(f"skipped: {name}: {reason}", flush=True)

    def close(self):
        """Prints the count and ends the program."""
        print(f"{self.passed} passed, {self.failed} failed, {self.skipped} skipped", flush=True)
        sys.exit(1 if self.failed else 0)

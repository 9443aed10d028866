"""Measured values beside their limits, as checks and as rows of a table."""
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from checks import Checks  # noqa: E402


class Figures(Checks):
    """Every check of a value keeps a row: case, what was measured, value, limit and its reason."""

    def __init__(self):
        super().__init__()
        self.case, self.rows = "", []

    def at_most(self, what, value, limit, unit, reason, digits=1):
        """Passes when a number is at most the limit."""
        shown = [f"{number:.{digits}f} {unit}".rstrip() for number in (value, limit)]
        self.row(what, shown[0], f"≤ {shown[1]}: {reason}")
        return self.check(f"{self.case}: {what}: {shown[0]}, at most {shown[1]}", value <= limit, reason)

    def exactly(self, what, value, expected, reason):
        """Passes when both are equal."""
        self.row(what, value, f"= {expected}: {reason}")
        return self.equal(f"{self.case}: {what}: {value}", value, expected)

    def row(self, what, value, limit=""):
        """A value for the table; one without a limit is only reported."""
        self.rows.append((self.case, what, str(value), limit))
        if not limit:
            print(f"    {self.case}: {what}: {value}", flush=True)

    def absent(self, reason):
        """The case cannot be tried on this host."""
        self.rows.append((self.case, "skipped", reason, ""))
        self.skip(self.case, reason)

    def table(self):
        """The rows as a table in Markdown; a name of a case and a reason appear once."""
        lines, before, reasons = ["| case | measured | value | limit |", "|---|---|---|---|"], None, {""}
        for case, what, value, limit in self.rows:
            limit, _, reason = limit.partition(": ")
            if reason not in reasons:
                limit += f": {reason}"
            reasons.add(reason)
            lines.append("| " + " | ".join([case if case != before else "", what, value, limit]) + " |")
            before = case
        return "\n".join(lines) + "\n"

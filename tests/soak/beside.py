"""A unit beside a calm one, and the limits that every case has."""
import contextlib
import os

from unit import Unit

#: The two units have some hundred samples each, of which the 99th percentile is the largest: one wake-up of a shared host.
CADENCE_US = 10_000
CADENCE_REASON = "the calm unit's, and 10 ms for a wake-up of a shared host"
GROWTH_KB = 4096
GROWTH_REASON = "as in tests/stress/run: what allocators keep"
END_S = 1.0
END_REASON = "docs/links.md"
#: As root the two have the processor before other work of the host.
REALTIME = ["--realtime"] if os.geteuid() == 0 else []


@contextlib.contextmanager
def beside_calm(geu, *words, **options):
    """A unit as `words` ask, and a calm one, which ends first."""
    with Unit(geu, "run", "--control", "off", "--tcp", "127.0.0.1:0", *REALTIME) as calm, \
            Unit(geu, "run", *words, *REALTIME, **options) as unit:
        unit.calm = calm
        yield unit


def ends(figures, unit, status=0, words=""):
    """Ends both; checks the time that it takes, and the cadence."""
    unit.calm.end()
    ended, took_s = unit.end()
    figures.at_most(f"end after SIGTERM{words}", took_s, END_S, "s", END_REASON, 2)
    figures.equal(f"{figures.case}: exit code{words}", ended, status)
    figures.equal(f"{figures.case}: panics{words}", [line for line in unit.errors if "panick" in line], [])
    keeps_time(figures, unit, words)


def keeps_time(figures, unit, words=""):
    """Of two that have ended: lateness and missed samples."""
    (_, p99), (_, calm) = unit.lateness_us(), unit.calm.lateness_us()
    figures.at_most(f"lateness, 99th percentile{words}", p99 / 1e3, (calm + CADENCE_US) / 1e3, "ms", CADENCE_REASON, 2)
    missed = unit.summary(r"^samples .* missed (\d+)")[1]
    figures.exactly(f"samples missed{words}", missed, "0", "no client disturbs the cadence")


def reads_all(figures, reader, seconds, words=""):
    """Of a client that reads: every sample within these seconds, and every reply but the last in transit."""
    reader.end()
    # Two samples may be under way at the ends.
    lost = sum((step - 1) % 65536 for step in reader.steps())
    figures.exactly(f"samples that the reading client lost{words}", lost, 0, f"of {len(reader.rows)} in {seconds:.0f} s")
    figures.check(f"{figures.case}: it stays connected and gets two a second{words}",
                  not reader.lost and len(reader.rows) >= 2 * seconds - 3, (reader.lost, len(reader.rows)))
    if reader.command:
        # The last may be in transit.
        figures.check(f"{figures.case}: its commands have replies{words}", reader.asked - len(reader.replies_s) <= 1,
                      f"{len(reader.replies_s)} of {reader.asked}")

"""Tests of the driver against the emulated unit, at ten times the speed of the unit. Each fault finds one kind of bug."""

import socket
import time

import pytest

pytestmark = pytest.mark.geu(link="tcp", speed=10, wait=True)


class Bench:
    """The driver on the unit's link."""

    def __init__(self, address, driver):
        host, port = address.rsplit(":", 1)
        self.socket = socket.create_connection((host, int(port)), timeout=5)
        self.driver = driver

    def read(self, samples, within_s=20):
        """The next increments."""
        increments, until = [], time.monotonic() + within_s
        while len(increments) < samples:
            assert time.monotonic() < until, f"{len(increments)} increments of {samples} within {within_s} s"
            data = self.socket.recv(4096)
            assert data, "the link was closed"
            increments += self.driver.feed(data)
        return increments


@pytest.fixture
def bench(geu_link, driver):
    bench = Bench(geu_link, driver)
    yield bench
    bench.socket.close()


def test_increments_arrive_in_order(bench):
    increments = bench.read(20)
    assert [increment.lost_samples for increment in increments] == [0] * len(increments)
    assert all(None not in increment.angles_arcsec for increment in increments)
    assert bench.driver.rejected_frames == 0


@pytest.mark.parametrize("gyro, place", [("GYRX", 0), ("GYRY", 1), ("GYRZA", 2), ("GYRZB", 3)])
def test_a_known_angle_has_its_sign_and_size(geu, bench, gyro, place):
    geu.inject("stuck-count", gyro, counts=120)
    angles = [increment.angles_arcsec[place] for increment in bench.read(20)]
    assert angles[-5:] == [120.0] * 5


def test_corrupted_frames_are_rejected(geu, bench):
    bench.read(3)
    geu.inject("bit-flip", "tcp", bits=3, when="frame % 2 == 0", for_s=0.5, times=100)
    increments = bench.read(20)
    geu.clear()
    assert bench.driver.rejected_frames > 5
    assert all(increment.lost_samples <= 1 for increment in increments)


def test_lost_frames_are_noticed(geu, bench):
    bench.read(3)
    geu.inject("drop", "tcp", when="frame % 5 == 0", for_s=0.5, times=100)
    increments = bench.read(30)
    assert sum(increment.lost_samples for increment in increments) >= 5


PLAN = """
[[fault]]
id = "dead-gyro"
at_s = 5.0
gyro = "GYRX"
fault = "dead"
"""


@pytest.mark.geu(faults=PLAN)
def test_a_dead_gyro_is_not_used(bench):
    increments = bench.read(20)
    assert None not in increments[0].angles_arcsec
    assert increments[-1].angles_arcsec[0] is None
    assert None not in increments[-1].angles_arcsec[1:]

"""The driver under test: the sound one, or one with a planted bug (`pytest --driver wrong-sign`)."""

import pytest
from gyro_driver import GyroDriver


class WrongSign(GyroDriver):
    """Takes the second gyro for mounted the other way."""

    def arcsec_per_count(self, gyro):
        return -super().arcsec_per_count(gyro) if gyro == 1 else super().arcsec_per_count(gyro)


class NoCrcCheck(GyroDriver):
    """Accepts every frame."""

    def is_intact(self, content, check):
        return True


class SequenceIgnored(GyroDriver):
    """Does not notice that frames are missing."""

    def lost_samples(self, sequence):
        return 0


DRIVERS = {"sound": GyroDriver, "wrong-sign": WrongSign, "no-crc-check": NoCrcCheck, "sequence-ignored": SequenceIgnored}


def pytest_addoption(parser):
    parser.addoption("--driver", choices=DRIVERS, default="sound", help="driver under test")


@pytest.fixture
def driver(request):
    return DRIVERS[request.config.getoption("--driver")]()

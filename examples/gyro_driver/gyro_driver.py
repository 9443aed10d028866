"""A small gyro driver of an on-board computer: serial frames to angular increments.

It reads the DATA frames of protocol/ICD.md from a stream, and does not know the emulator. Replace it with your own.
"""

import struct
from dataclasses import dataclass

SYNC = b"\xeb\x90"
DATA, PAYLOAD_LENGTH = 0x01, 22
ARCSEC_PER_COUNT = 1.0


def crc16(data):
    """CRC-16/IBM-3740."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


@dataclass(frozen=True)
class Increment:
    """Angles turned about the four gyros' axes since the sample before, arcsec; None for a gyro that is not valid."""

    sequence: int
    angles_arcsec: tuple
    lost_samples: int


class GyroDriver:
    """Finds frames in a stream of bytes; the bytes between them are noise."""

    def __init__(self):
        self.buffer = b""
        self.last_sequence = None
        self.rejected_frames = 0

    def feed(self, data):
        """Adds received bytes; returns the increments of the frames that are complete."""
        self.buffer += data
        increments = []
        while (start := self.buffer.find(SYNC)) >= 0:
            self.buffer = self.buffer[start:]
            if len(self.buffer) < 4 + PAYLOAD_LENGTH + 2:
                break
            kind, length = self.buffer[2:4]
            payload, check = self.buffer[4:4 + length], self.buffer[4 + length:6 + length]
            if kind != DATA or length != PAYLOAD_LENGTH:
                # A reply to a command, or noise that looks like a frame.
                self.buffer = self.buffer[2:]
                continue
            if not self.is_intact(self.buffer[2:4] + payload, check):
                self.rejected_frames += 1
                self.buffer = self.buffer[2:]
                continue
            self.buffer = self.buffer[6 + length:]
            increments.append(self.increment(payload))
        return increments

    def is_intact(self, content, check):
        return crc16(content) == int.from_bytes(check, "big")

    def increment(self, payload):
        sequence, *counts, gyro_flags, _ = struct.unpack(">H4hBB", payload[:12])
        angles = tuple(count * self.arcsec_per_count(gyro) if gyro_flags >> gyro & 1 else None for gyro, count in enumerate(counts))
        lost = self.lost_samples(sequence)
        self.last_sequence = sequence
        return Increment(sequence, angles, lost)

    def arcsec_per_count(self, gyro):
        return ARCSEC_PER_COUNT

    def lost_samples(self, sequence):
        """Samples between this and the last one."""
        return 0 if self.last_sequence is None else (sequence - self.last_sequence - 1) % 0x10000

"""XTCE and COSMOS definitions of every unit, read by space_packet_parser and OpenC3: the values equal the output of `geu decode`."""
import csv
import logging
import math
import os
import subprocess
import tempfile
import warnings
from pathlib import Path
from types import SimpleNamespace

from wire import COMMAND, frame

#: OpenC3 would send its messages to a database.
os.environ["OPENC3_NO_STORE"] = "1"
DEVICES = ("iras", "hg4930", "kvh-1750", "mm5.10", "mti-100", "openimu300ri", "stim300", "stim300-increment", "tetrad")
#: Bits of the two fields of flags that `geu decode` prints as numbers, from bit 0 on.
HEADS = ("gyrx", "gyry", "gyrza", "gyrzb")
FLAGS = {"gyro_flags": [f"{head}_{state}" for state in ("valid", "saturated") for head in HEADS],
         "unit_flags": ["heater_in_band", "motors_synchronous", "clock_locked", "self_test", "polled"]}
XTCE = "{http://www.omg.org/spec/XTCE/20180204}"


class Unit:
    """A simulated unit: its recording, the rows of it, and the definitions."""

    def __init__(self, geu, device, wire, directory):
        self.name, self.geu, self.device = f"{device} on {wire}", geu, device
        run = directory / f"{device}-{wire}"
        seconds = 5 if device == "iras" else 0.2
        config = directory / f"{device}-{wire}.toml"
        config.write_text(f'device = "{device}"\n[[motion]]\nduration_s = {seconds}\nx_deg_s = 0.15\nend_x_deg_s = -0.1\n'
                          "y_deg_s = -0.12\nz_deg_s = 0.04\nend_z_deg_s = 0.19\n")
        self.call("simulate", config, "--wire", wire, "--duration", seconds, "--out", run)
        self.link = next(run.glob("link.*"))
        self.is_can = self.link.suffix == ".log"
        rows = csv.DictReader(self.call("decode", "--device", device, self.link).splitlines())
        columns = {}
        for row in rows:
            for name, cell in row.items():
                columns.setdefault(name, []).append(float(cell) if cell else None)
        for flags, bits in FLAGS.items():
            for bit, name in enumerate(bits if flags in columns else []):
                columns[name] = [int(value) >> bit & 1 for value in columns[flags]]
        self.columns = {name.lower(): column for name, column in columns.items()}
        self.xtce, self.cosmos = directory / f"{device}.xml", directory / f"{device}.txt"
        for form, file in (("xtce", self.xtce), ("cosmos", self.cosmos)):
            file.write_text(self.call("describe", form, "--device", device))

    def call(self, *arguments):
        command = [self.geu, *map(str, arguments)]
        return subprocess.run(command, text=True, capture_output=True, check=True).stdout

    def can_frames(self):
        """The frames as packets of link type 227 (CAN_SOCKETCAN)."""
        for line in self.link.read_text().splitlines():
            name, data = line.split()[2].split("#")
            identifier = int(name, 16) | (1 << 31 if len(name) > 3 else 0)
            yield identifier.to_bytes(4, "big") + bytes([len(data) // 2, 0, 0, 0]) + bytes.fromhex(data)

    def compare(self, checks, reader, packets):
        """Checks that packets, each a name and its values, have the values of the rows in their order."""
        series, kinds = {}, {}
        for kind, values in packets:
            kinds[kind] = kinds.get(kind, 0) + 1
            for name, value in values.items():
                name = name.lower()
                name = name if name in self.columns else name.removeprefix(f"{kind.lower()}_")
                if name in self.columns:
                    series.setdefault(name, {}).setdefault(kind, []).append(value)
                    series[name].setdefault(None, []).append(value)
        wrong = []
        for name, column in self.columns.items():
            expected = [value for value in column if value is not None]
            # A value may be in each of several packets, or in one after the other.
            if name in series:
                found = series[name].values()
                if not any(len(got) == len(expected) and all(
                        math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9) for a, b in zip(got, expected)) for got in found):
                    wrong.append((name, expected[:3], [got[:3] for got in found]))
        checks.check(f"{self.name}: {reader} reads {len(series)} values of {sum(kinds.values())} packets as geu decode does",
                     series and not wrong, wrong[:3])
        # Flags are compared bit by bit.
        missing = [name for name, column in self.columns.items() if name not in series and name not in FLAGS
                   and any(value is not None for value in column)]
        return missing


def xtce_packets(unit, parser, tree):
    """The packets that space_packet_parser reads."""
    if unit.is_can:
        for packet in unit.can_frames():
            yield parsed(parser, packet, "can")
        return
    containers = {element.get("name"): element for element in tree.iter(f"{XTCE}SequenceContainer")}
    base, data, at = containers.pop("serial"), unit.link.read_bytes(), 0
    sizes = {name: int(element.findtext(f"{XTCE}BinaryEncoding/{XTCE}SizeInBits/{XTCE}FixedValue")) // 8
             for name, element in containers.items() if element.find(f"{XTCE}BaseContainer[@containerRef='serial']") is not None}
    located = {entry.get("parameterRef"): int(entry.findtext(f"{XTCE}LocationInContainerInBits/{XTCE}FixedValue"))
               for entry in base.iter(f"{XTCE}ParameterRefEntry") if len(entry)}
    widths = {element.get("name").removesuffix("_type"): int(element.find(f".//*[@sizeInBits][@encoding]").get("sizeInBits"))
              for element in tree.find(f".//{XTCE}ParameterTypeSet")}
    while at < len(data):
        for name, size in sizes.items():
            packet = data[at:at + size]
            bits = lambda first, count: int.from_bytes(packet, "big") >> (8 * size - first - count) & ((1 << count) - 1)
            comparisons = containers[name].iter(f"{XTCE}Comparison")
            # space_packet_parser knows no places of entries: these selectors are compared here.
            if located and all(bits(located[c.get("parameterRef")], widths[c.get("parameterRef")]) == int(c.get("value"))
                               for c in comparisons):
                found = parsed(parser, packet, name, name)
                break
            if not located and (found := parsed(parser, packet, "serial")) and found[0] == name:
                break
        else:
            raise ValueError(f"no container for {data[at:at + 8].hex()}")
        yield found
        at += size


def parsed(parser, packet, root, name=None):
    """Name and values of a packet; `None` if the definition has no such packet."""
    from space_packet_parser.exceptions import UnrecognizedPacketTypeError
    try:
        values = parser.parse_bytes(packet, root_container_name=root)
    except (UnrecognizedPacketTypeError, KeyError):
        return None
    ends = [kind for kind, own in parser.containers.items() if own.base_container_name == root and own.restriction_criteria
            and all(criterion.evaluate(values) for criterion in own.restriction_criteria)]
    return name or ends[0], values


def xtce(checks, unit):
    from lxml import etree
    from space_packet_parser.xtce.definitions import XtcePacketDefinition
    from space_packet_parser.xtce.validation import validate_xtce
    logging.getLogger("space_packet_parser").setLevel(logging.WARNING)
    result = validate_xtce(str(unit.xtce), allow_schema_download=False, print_results=False, raise_on_error=False)
    checks.check(f"{unit.name}: valid by the schema of XTCE {result.schema_version}", result.valid, result.errors)
    parser, tree = XtcePacketDefinition.from_xtce(str(unit.xtce)), etree.parse(str(unit.xtce))
    with warnings.catch_warnings():
        # A packet of more or fewer bits than its container is a warning.
        warnings.simplefilter("error")
        missing = unit.compare(checks, "space_packet_parser", xtce_packets(unit, parser, tree))
    checks.equal(f"{unit.name}: the columns that no packet has", [name for name in missing if name not in ("t_s", "sample", "number")], [])
    if unit.device == "iras" and not unit.is_can:
        commands = {command.get("name"): command for command in tree.iter(f"{XTCE}MetaCommand")}
        got = b"".join(bytes.fromhex(entry.get("binaryValue")) if entry.get("binaryValue") else
                       {"gyros": b"\1", "counts": b"\0\x64", }.get(entry.get("argumentRef"), b"\2")
                       for entry in commands["SELF_TEST"].find(f".//{XTCE}EntryList"))
        checks.equal("iras: the command container of SELF_TEST is the frame but for its CRC", got[:-2],
                     frame(COMMAND, bytes.fromhex("0401006402"))[:-2])


def cosmos(checks, unit):
    from openc3.interfaces import interface
    from openc3.interfaces.protocols import burst_protocol, crc_protocol
    from openc3.interfaces.protocols.crc_protocol import CrcProtocol
    from openc3.interfaces.protocols.fixed_protocol import FixedProtocol
    from openc3.packets.commands import Commands
    from openc3.packets.packet_config import PacketConfig
    from openc3.packets.telemetry import Telemetry
    from openc3.system.system import System
    errors = []
    logger = SimpleNamespace(error=errors.append, info=lambda message: None)
    interface.Logger = burst_protocol.Logger = crc_protocol.Logger = logger
    lines = unit.cosmos.read_text().splitlines()
    target = next(line.split()[-1] for line in lines if line.startswith("#   TARGET "))
    config = PacketConfig()
    config.process_file(str(unit.cosmos), target)
    # The sync is removed with the CRC protocol; the one packet of the tetrad has no other constant.
    warned = [text for text in config.warnings if unit.device != "tetrad" or "has no ID_ITEMS" not in text]
    checks.equal(f"{unit.name}: COSMOS reads the definitions without a warning", warned, [])
    System.telemetry, System.commands = Telemetry(config, System), Commands(config, System)

    class Link(interface.Interface):
        """An interface that reads from a list."""

        def __init__(self, chunks):
            super().__init__()
            self.chunks, self.written, self.name = list(chunks), b"", "LINK"
            self.target_names = self.tlm_target_names = self.cmd_target_names = [target]
            for line in lines:
                words = line.removeprefix("#").split()
                if words[:1] == ["PROTOCOL"] and not unit.is_can:
                    self.add_protocol({"FixedProtocol": FixedProtocol, "CrcProtocol": CrcProtocol}[words[2]], words[3:], words[1])

        def connected(self):
            return True

        def read_interface(self):
            return (self.chunks.pop(0), None) if self.chunks else (None, None)

        def write_interface(self, data, extra=None):
            self.written += data

        def packets(self):
            while packet := self.read():
                found = System.telemetry.identify(packet.buffer, [target])
                if found is None:
                    raise ValueError(f"no packet for {packet.buffer.hex()}")
                found.buffer = packet.buffer
                yield found.packet_name, {name: found.read(name, "RAW" if item.states else "CONVERTED")
                                          for name, item in found.items.items() if not name.startswith(("RECEIVED", "PACKET_TIME"))}

    data = unit.link.read_bytes()
    chunks = unit.can_frames() if unit.is_can else [data[at:at + 7] for at in range(0, len(data), 7)]
    unit.compare(checks, "COSMOS", Link(chunks).packets())
    checks.equal(f"{unit.name}: COSMOS reports no error", errors, [])
    if any("CrcProtocol" in line for line in lines):
        damaged = bytearray(data)
        damaged[10] ^= 1
        list(Link([bytes(damaged)]).packets())
        checks.check(f"{unit.name}: COSMOS reports the CRC of a damaged frame", len(errors) == 1 and "Invalid CRC" in errors[0], errors)
    if unit.device == "iras" and not unit.is_can:
        cases = [("PING", {}, "01"), ("SET_MODE", {"MODE": "POLLED"}, "0201"), ("GYRO_POWER", {"GYROS": 14}, "060E"),
                 ("SELF_TEST", {"GYROS": 1, "COUNTS": -100}, "0401FF9C01")]
        for name, values, payload in cases:
            link = Link([])
            link.write(System.commands.build_cmd(target, name, values))
            checks.equal(f"iras: COSMOS sends {name} as the frame", link.written, frame(COMMAND, bytes.fromhex(payload)))
        replies = [packet for packet in Link([frame(0x11, bytes.fromhex("01000100")), frame(0x11, b"\x09\1")]).packets()]
        checks.equal("iras: COSMOS reads replies", [(name, values["RESULT"]) for name, values in replies],
                     [("REPLY_PING", 0), ("REPLY", 1)])


def ground_systems(geu, checks):
    """Checks the definitions of all units that have a link."""
    readers = []
    for name, module, read in (("XTCE", "space_packet_parser", xtce), ("COSMOS", "openc3", cosmos)):
        try:
            __import__(module)
            readers.append(read)
        except ImportError:
            checks.skip(name, f"{module} is absent: pip install -r tests/requirements.txt")
    with tempfile.TemporaryDirectory() as directory:
        wires = [("iras", "can"), *((device, "can" if device in ("mm5.10", "openimu300ri") else "serial") for device in DEVICES)]
        for device, wire in wires if readers else []:
            unit = Unit(geu, device, wire, Path(directory))
            for read in readers:
                if (read, device, wire) != (cosmos, "iras", "can"):
                    read(checks, unit)

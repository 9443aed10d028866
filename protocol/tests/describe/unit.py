"""Prints the signals of CAN frames, a line for each. Arguments: a database, and a file with lines `identifier bytes`."""
import sys

import cantools

database = cantools.database.load_file(sys.argv[1], strict=True)
for line in open(sys.argv[2]):
    identifier, data = line.split()
    signals = database.decode_message(int(identifier), bytes.fromhex(data))
    print(*(f"{name}={float(value)}" for name, value in signals.items()))

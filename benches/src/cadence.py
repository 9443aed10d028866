"""python-can's periodic task on a virtual bus: lateness of each frame, ns, one a line in a file.

Its deadlines begin with its earliest frame, as it has no start of its own that could be given.
"""
import sys
import time

import can

duration_s, period_s, out = float(sys.argv[1]), float(sys.argv[2]), sys.argv[3]
times_ns = []


class Reader(can.Listener):
    def on_message_received(self, message):
        times_ns.append(message.timestamp * 1e9)


with can.Bus("bench", interface="virtual") as sender, can.Bus("bench", interface="virtual", preserve_timestamps=True) as receiver:
    notifier = can.Notifier(receiver, [Reader()])
    task = sender.send_periodic(can.Message(arbitration_id=0x1A0, data=bytes(8), is_extended_id=False), period_s)
    time.sleep(duration_s)
    task.stop()
    notifier.stop()
late_ns = [sent_ns - times_ns[0] - index * period_s * 1e9 for index, sent_ns in enumerate(times_ns)]
with open(out, "w") as file:
    file.writelines(f"{late - min(late_ns):.0f}\n" for late in late_ns)

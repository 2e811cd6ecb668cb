"""Damaged records: cut off, with bytes changed, and with bytes of something else behind them.

``python tests/damage.py [COUNT]`` reads so many (10,000) of them, within a minute or two, and tells how many
messages were read.
"""

from __future__ import annotations

import io
import json
import random
import sys
import tempfile
from collections import Counter
from pathlib import Path

from records import HEAD, decision, encoded

from mdm.errors import FormatError
from mdm.messages import Decision
from mdm.recording.process import File
from mdm.recording.reader import Record
from mdm.recording.schemas import schema

MESSAGES = 400


def sound():
    """Return a record of several chunks as bytes, and its messages, encoded."""
    messages = [encoded(decision(number)) for number in range(MESSAGES)]
    content = io.BytesIO()
    file = File(content, "mdm/0.1.0", chunk=4096)
    file.metadata("mdm.file", {"record": "a", "number": "0"})
    file.metadata("mdm", HEAD)
    file.attach("robot.toml", "application/toml", b"[ensembles]")
    topic = file.topic("decisions", "mdm.Decision", json.dumps(schema(Decision)).encode())
    for number, message in enumerate(messages):
        file.add_message(topic, number * 1_000_000, message, number * 1_000_000, number)
    file.finish()
    return content.getvalue(), messages


def damaged(content, choice):
    """Return a record with some damage in its tail."""
    start = choice.randrange(len(content) // 8, len(content))
    kind = choice.choice(["cut", "flip", "flips", "zeros", "noise", "repeat", "length"])
    tail = bytearray(content[start:])
    if kind == "cut":
        tail = bytearray()
    elif kind in {"flip", "flips"} and tail:
        for _ in range(1 if kind == "flip" else choice.randrange(2, 20)):
            tail[choice.randrange(len(tail))] ^= 1 << choice.randrange(8)
    elif kind == "zeros":
        tail = bytearray(len(tail))
    elif kind == "noise":
        tail = bytearray(choice.randbytes(len(tail)))
    elif kind == "repeat":
        tail = bytearray(content[choice.randrange(len(content)) :])
    elif kind == "length":
        tail[:8] = b"\xff" * 8
    return content[:start] + tail


def read(path, messages):
    """Read a damaged record; return how many messages, and what was told of damage; raise for a wrong one."""
    record = Record(path)
    found = list(record.raw())
    for topic, time, sequence, data in found:
        assert (topic, time, data) == ("decisions", sequence * 1_000_000, messages[sequence]), path
    numbers = [each[2] for each in found]
    assert numbers == sorted(set(numbers)), path
    if len(numbers) < len(messages):
        assert record.torn is not None or record.lost == len(messages) - len(numbers), path
    if numbers != list(range(len(numbers))):
        assert record.gap is not None, path
        assert record.gap.sequence == next((place for place, number in enumerate(numbers) if place != number), 0) - 1
        assert record.damage, path
    return len(numbers), record.torn or "".join(record.damage) or None


def main(count):
    choice = random.Random(1)
    kept, reasons = 0, Counter()
    content, messages = sound()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.mcap"
        for _ in range(count):
            path.write_bytes(damaged(content, choice))
            try:
                number, torn = read(path, messages)
            except FormatError as error:
                reasons[str(error).removeprefix(str(path))] += 1
                continue
            kept += number
            reasons["whole" if torn is None else torn.partition(": ")[2].partition(",")[0]] += 1
    print(f"{count:,} damaged records: {kept / count:.0f} of {MESSAGES} messages kept on average, none wrong")
    for reason, times in reasons.most_common():
        print(f"{times:7,}  {reason}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)

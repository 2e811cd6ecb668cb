"""Records for tests: written by the process, read by the official reader."""

from __future__ import annotations

import fcntl
import io
from pathlib import Path

import msgspec
from mcap.reader import make_reader
from mcap.writer import Writer
from patience import PATIENCE
from places import EXAMPLES

from mdm import load_system, messages
from mdm.recording import Record, schemas
from mdm.recording.process import File
from mdm.recording.writer import FileSettings, RecordWriter
from mdm.runtime import Runtime, run as run_program

HEAD = {"format": "1", "mdm": "0.1.0", "clock": "virtual", "epoch": "0"}


def encoded(message):
    return msgspec.json.encode(message, enc_hook=lambda array: array.tolist())


def decision(number, *, name="Go", ensemble="patrol", **fields):
    given = {
        "state": number % 3,
        "observation": None,
        "belief": None,
        "action": 1,
        "action_name": name,
        "reward": 0.5,
        "cause": "state",
        "epoch": number,
        **fields,
    }
    return messages.Decision(time=number * 1_000_000, ensemble=ensemble, **given)


class Writing:
    """A record that is open, and takes messages by the names of topics."""

    def __init__(self, path, head=HEAD, **options):
        bound = {"bound": options.pop("bound")} if "bound" in options else {}
        self.writer = RecordWriter(path, FileSettings(**options), **bound)
        self.writer.open()
        if head is not None:
            self.writer.metadata("mdm", head)
        self.topics = {}

    def write(self, topic, message, kind=None):
        kind = kind or type(message)
        if topic not in self.topics:
            self.topics[topic] = self.writer.topic(topic, schemas.name(kind), schemas.schema(kind))
        self.writer.write(self.topics[topic], message.time, encoded(message))

    def close(self):
        self.writer.close(PATIENCE)
        assert self.writer.failure is None
        return self.writer.path


def written(path, messages, head=HEAD, **options):
    """Write pairs of topic and message; return the path."""
    record = Writing(path, head, **options)
    for topic, message in messages:
        record.write(topic, message)
        record.writer.flush()
    return record.close()


def official(path):
    """Return what the official reader reads, checksums included: topic, time, sequence, publish time, data."""
    with Path(path).open("rb") as file:
        return [
            (channel.topic, message.log_time, message.sequence, message.publish_time, message.data)
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)
        ]


def wait_until_written(path):
    """Wait until no process records to a file any more."""
    with Path(path).open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_SH)


def run(path, file, inputs, *, stop=None):
    """Run a TOML file in virtual time, without its functions, on what is sensed at some times; record it.

    Args:
        path: The record.
        file: The TOML file.
        inputs: Triples of seconds, predicates and events.
        stop: Seconds at which it ends; by default those of the last input.
    """
    system = load_system(file, callbacks=False)

    async def main():
        async with Runtime(log=False, record=path) as runtime:
            await runtime.start(system)
            for seconds, predicates, events in inputs:
                await runtime.clock.sleep(seconds - runtime.clock.now() / 1e9)
                with system.predicates.batch():
                    for name, value in predicates.items():
                        system.predicates.sense(name, value)
                    if events:
                        system.predicates.occur(*events)
            await runtime.clock.sleep((inputs[-1][0] if stop is None else stop) - runtime.clock.now() / 1e9, rank=2)

    run_program(main, virtual=True)
    return path


def tiger(path):
    """Record the example of the tiger, which listens and opens a door, for ten seconds."""
    heard = ["HearLeft", "HearRight", "HearRight", "HearRight", "HearLeft", "HearLeft", "HearLeft"]
    return run(path, EXAMPLES / "tiger.toml", [(0.4 + 0.7 * number, {}, [heard[number % 7]]) for number in range(14)])


def with_gap(path, new, first, count):
    """Write a record once more without some of its messages, whose numbers are left out; return the new record."""
    record = Record(path)
    content = io.BytesIO()
    file = File(content, "mdm/0.1.0")
    for name, facts in record.metadata.items():
        if name != "mdm.file":
            file.metadata(name, facts)
    for attachment in record.attachments:
        file.attach(*attachment)
    topics = {name: file.topic(*topic) for name, topic in record.topics.items()}
    for topic, time, sequence, data in record.raw():
        if not first <= sequence < first + count:
            file.add_message(topics[topic], time, data, time, sequence)
    file.finish()
    new.write_bytes(content.getvalue())
    return Record(new)


def copied(content, *, metadata_last=False, **options):
    """Return a record that the official library has read and written anew, with options of its own."""
    found = make_reader(io.BytesIO(content), validate_crcs=True)
    output = io.BytesIO()
    writer = Writer(output, **options)
    writer.start(library=f"another/1.0 {options}")
    channels = {}

    def describe():
        for each in found.iter_metadata():
            writer.add_metadata(each.name, each.metadata)
        for each in found.iter_attachments():
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)

    if not metadata_last:
        describe()
    for schema, channel, message in found.iter_messages(log_time_order=False):
        if channel.id not in channels:
            number = 0 if schema is None else writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
        stamps = message.log_time, message.data, message.publish_time, message.sequence
        writer.add_message(channels[channel.id], *stamps)
    if metadata_last:
        describe()
    writer.finish()
    return output.getvalue()

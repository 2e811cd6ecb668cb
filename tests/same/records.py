"""Records of random systems in virtual time: each message's topic, times and bytes, as another program reads them."""

from __future__ import annotations

import tempfile
from pathlib import Path

from mcap.reader import make_reader
from same import systems


def seen(seed, tree):
    """Return what the record of a seed's system holds; what differs by machine is left out."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        systems.seen(seed, tree, record=path)
        with path.open("rb") as opened:
            return [
                f"{channel.topic} {schema.name} {message.log_time} {message.publish_time} {message.data.hex()}"
                for schema, channel, message in make_reader(opened).iter_messages(log_time_order=False)
                if channel.topic != "process"
            ]

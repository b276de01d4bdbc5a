"""Opens a recording with the `mcap` package and prints what is in it as one JSON object.

    pip install mcap
    python3 read_mcap.py FILE.mcap

`complete` says whether the file has its end (a process that was killed leaves none); messages are counted either way.
"""

import json
import struct
import sys
from collections import Counter

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

# What the package raises where a file is cut off, as the place has it.
TORN = (McapError, EOFError, struct.error)

FRAME_HEADER = struct.Struct("<BBBBIIIIfQQII")
TWIST = struct.Struct("<BBHHHQQIIII6d3dd8x")


def check(channel, message):
    """Reads a message in the format that its channel names; raises if it is not in that format."""
    if channel.message_encoding == "json":
        assert isinstance(json.loads(message.data), dict)
    elif channel.message_encoding == "domvs-frame-v1":
        flags = FRAME_HEADER.unpack_from(message.data)[3]
        assert flags == 0, "a recorded header has no secret"
    elif channel.message_encoding == "domvs-twist-v1":
        assert TWIST.unpack(message.data)[0] == 1
    else:
        raise AssertionError(f"unknown message encoding {channel.message_encoding!r}")


def read_indexed(path):
    """Everything by way of the summary, as viewers read it."""
    topics, metadata = Counter(), {}
    with open(path, "rb") as file:
        reader = make_reader(file)
        for _, channel, message in reader.iter_messages():
            check(channel, message)
            topics[channel.topic] += 1
        for record in reader.iter_metadata():
            metadata[record.name] = record.metadata
        counted = sum(reader.get_summary().statistics.channel_message_counts.values())
    assert counted == sum(topics.values())
    return topics, metadata


def read_from_the_front(path):
    """All whole chunks of a file without end."""
    topics, channels = Counter(), {}
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    check(channels[record.channel_id], record)
                    topics[channels[record.channel_id].topic] += 1
        except TORN:
            pass
    return topics, {}


def main(path):
    try:
        topics, metadata = read_indexed(path)
        complete = True
    except TORN:
        topics, metadata = read_from_the_front(path)
        complete = False
    print(json.dumps({"complete": complete, "topics": dict(sorted(topics.items())), "metadata": metadata}))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])

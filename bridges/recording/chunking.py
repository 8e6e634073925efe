"""An MCAP file whose messages are not in chunks, as one whose are: only chunks are indexed.

rosbag2 writes such files with the preset ``fastwrite``.
"""

from __future__ import annotations

from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.well_known import Profile
from mcap.writer import Writer

from .bags import temporary_file
from .mcap_file import LONGEST_RECORD, McapFile

__all__ = ["in_chunks"]


def in_chunks(source: McapFile, owner: object) -> McapFile:
    """Return a file with the same messages in chunks, which goes with ``owner``; or the same file.

    As much of a damaged file is in it as can be read.
    """
    if not source.is_unchunked:
        return source
    target = temporary_file(owner)
    with source.path.open("rb") as read, target.open("wb") as written:
        writer = Writer(written)
        writer.start(profile=Profile.ROS2)
        try:
            _copy(StreamReader(read, record_size_limit=LONGEST_RECORD), writer)
        except Exception:  # whatever the library raises for a file that is cut short or damaged
            source.complete = False
        writer.finish()
    found = McapFile(target)
    found.complete = source.complete
    return found


def _copy(source: StreamReader, writer: Writer) -> None:
    schemas = {0: 0}
    channels: dict[int, int] = {}
    for record in source.records:
        match record:
            case Schema():
                schemas[record.id] = writer.register_schema(
                    record.name, record.encoding, record.data
                )
            case Channel():
                channels[record.id] = writer.register_channel(
                    record.topic,
                    record.message_encoding,
                    schemas[record.schema_id],
                    record.metadata,
                )
            case Message():
                writer.add_message(
                    channels[record.channel_id],
                    record.log_time,
                    record.data,
                    record.publish_time,
                    record.sequence,
                )

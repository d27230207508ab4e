"""Topics and messages of a ROS bag, read with rosbags: ROS 1 and 2, and MCAP with ROS 2 messages."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore
from tqdm import tqdm

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.units import NS_PER_S
from drd_tools.importing.streams import Origin, Times


class Bag:
    """An opened bag: `types` and `counts` of messages by topic, `seconds` from the first to the last one.

    `stamps`: use the header's times or those of receipt ("header", "receive"). Raises ConfigError.
    """

    def __init__(self, path: Path, stamps: str):
        self.path, self._stamps = path, stamps
        self.types: dict[str, str] = {}
        self.counts: dict[str, int] = {}
        with self._reader() as reader:
            self.seconds = reader.duration / NS_PER_S
            for c in reader.connections:
                self.types[c.topic] = c.msgtype
                self.counts[c.topic] = self.counts.get(c.topic, 0) + c.msgcount
        if not self.types:
            raise ConfigError(str(path), "", "a recording with topics", "none")

    def kind(self, topic: str, option: str) -> str:
        """Message type of a topic. Raises ConfigError if there is no such topic."""
        if topic not in self.types:
            raise ConfigError(str(self.path), option, f"one of {', '.join(sorted(self.types))}", repr(topic))
        return self.types[topic]

    def read(self, topic: str, pick: Callable[[Any], Any]) -> tuple[Times, list[Any], Origin]:
        """Read times, and `pick` of each message, in the order of the file. Raises ConfigError."""
        header, received, picked = [], [], []
        bare = False
        with self._reader() as reader:
            wanted = [c for c in reader.connections if c.topic == topic]
            if len(types := sorted({c.msgtype for c in wanted})) > 1:  # without a header: times of two kinds
                raise ConfigError(str(self.path), topic, "messages of one type", " and ".join(types))
            bar = tqdm(total=self.counts[topic], desc=topic, unit=" messages", disable=None, leave=False, delay=1.0)
            with bar:
                for connection, received_ns, raw in reader.messages(wanted):
                    message: Any = reader.deserialize(raw, connection.msgtype)
                    bare = not hasattr(message, "header")
                    stamp = None if bare else message.header.stamp
                    header.append(0 if stamp is None else int(stamp.sec) * NS_PER_S + int(stamp.nanosec))
                    received.append(received_ns)
                    picked.append(pick(message))
                    bar.update()
        if not picked:
            raise ConfigError(str(self.path), topic, "messages", "none")
        time_ns, origin = self._times(topic, np.array(header, np.int64), np.array(received, np.int64), bare=bare)
        return time_ns, picked, origin

    def numbers(self, topic: str, pick: Callable[[Any], Sequence[float]]) -> tuple[Times, Array, Origin]:
        """Read times, and the numbers from `pick`, which must be finite: shape (n, k)."""
        time_ns, picked, origin = self.read(topic, pick)
        values = np.array(picked, dtype=float)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            got = f"{values[bad[0]].tolist()} in message {bad[0] + 1}"
            raise ConfigError(str(self.path), topic, "finite numbers", got)
        return time_ns, values, origin

    def _times(self, topic: str, header: Times, received: Times, *, bare: bool) -> tuple[Times, Origin]:
        origin = Origin(topic, self.types[topic], self._stamps)
        if (header == 0).all():
            if self._stamps == "header" and not bare:
                expected = "stamps in the headers, or --stamps receive"
                raise ConfigError(str(self.path), topic, expected, "headers whose stamps are all zero")
            if self._stamps == "header":
                origin.notes.append("its messages have no header: times of receipt")
            origin.stamps = "receive"
            return received, origin
        low, middle, high = np.percentile((received - header) / NS_PER_S, (0, 50, 100))
        origin.notes.append(f"received {middle:.4f} s after the header's stamp (median; {low:.4f} to {high:.4f})")
        return header if self._stamps == "header" else received, origin

    @contextmanager
    def _reader(self) -> Iterator[AnyReader]:
        try:
            # Bags older than ROS 2 Iron hold no definitions; standard messages are the same in all releases.
            with AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
                yield reader
        except ConfigError:
            raise
        except (AnyReaderError, OSError) as error:
            raise ConfigError(str(self.path), "", "a ROS bag, or MCAP with ROS 2 messages", str(error)) from error
        except Exception as error:  # for a damaged bag, the parsers may raise anything
            got = f"{type(error).__name__}: {error}"
            raise ConfigError(str(self.path), "", "a bag that can be read", got) from error

"""A flipped bit of a file is an error that names the file, or the data are equal.

With `JOSTLE_LONG=1` every bit is flipped, else every 40th.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import mcap.reader
import pandas as pd
import pyarrow.parquet as pq
import pytest
from blake3 import blake3
from mcap.writer import CompressionType, Writer

import jostle
from conftest import JOSTLED, MAX_WAIT_SECS, ROOT, Daemon, eventually

EVERY = 1 if "JOSTLE_LONG" in os.environ else 40

PLAN = """
name = "kinds"
replicates = 4
duration = 10
[[grid]]
n = [3]
[measure]
columns = ["order", "milling"]
order_every = 4
series_every = 4
record_every = 10
"""
TABLES = ("results", "order", "series", "trajectories/run-000002")


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an experiment with a file of each kind."""
    folder = tmp_path_factory.mktemp("kinds")
    plan = folder / "kinds.toml"
    plan.write_text(PLAN, encoding="utf-8")
    command: list[str | Path] = [JOSTLED, "run", plan, "-o", folder / "out"]
    subprocess.run(command, check=True, capture_output=True, timeout=MAX_WAIT_SECS)
    return folder / "out"


@pytest.fixture
def take(
    daemon: Daemon, create: Callable[..., jostle.Swarm], client: jostle.Client, tmp_path: Path
) -> Path:
    """A folder with a recording of each format."""
    swarm = create(n=3, rate=None, publish_every=1)
    record(daemon, client, swarm, 6, tmp_path / "take.parquet", tmp_path / "take.mcap")
    return tmp_path


def record(
    daemon: Daemon, client: jostle.Client, swarm: jostle.Swarm, steps: int, *paths: Path
) -> None:
    """Records steps of a swarm to files."""
    line = [str(JOSTLED.with_name("jostle")), "-e", daemon.endpoint, "record", swarm.name]
    more = ["--steps", str(steps)]
    begun = [subprocess.Popen([*line, "-o", str(path), *more]) for path in paths]

    def going() -> int:
        return sum(it.swarm == swarm.name for it in client.recordings())

    eventually("it records", lambda: going() == len(paths))
    for _ in range(steps):
        swarm.step()
    for recorder in begun:
        assert recorder.wait(MAX_WAIT_SECS) == 0


def rows(path: Path) -> str:
    return jostle.read_table(path).to_csv()


def recorded(path: Path) -> tuple[dict[str, str], str]:
    recording = jostle.read_recording(path)
    return dict(recording.about), recording.frame().to_csv()


def each_flip(
    path: Path, read: Callable[[Path], object], every: int = EVERY, is_checked: bool = True
) -> int:
    """Flips bits of a copy, each alone, and returns how many were found."""
    whole = path.read_bytes()
    expected = read(path)
    flipped = path.with_name(f"flipped-{path.name}")
    flipped.write_bytes(whole)
    found = 0
    with flipped.open("r+b", buffering=0) as file:
        for bit in range(0, 8 * len(whole), every):
            place = bit // 8
            os.pwrite(file.fileno(), bytes([whole[place] ^ 1 << bit % 8]), place)
            problem = ""
            try:
                assert read(flipped) == expected or not is_checked, bit
            except jostle.InvalidArgument as error:
                problem = str(error)
            assert not problem or str(flipped) in problem, bit
            found += bool(problem)
            os.pwrite(file.fileno(), whole[place : place + 1], place)
    return found


@pytest.mark.parametrize("name", TABLES)
def test_a_flipped_bit_of_a_table_is_found(results: Path, name: str) -> None:
    path = results / f"{name}.parquet"
    assert pq.read_metadata(path).num_rows > 3
    assert each_flip(path, rows) > 500


def test_a_flipped_bit_of_a_recording_is_found(take: Path) -> None:
    assert each_flip(take / "take.parquet", recorded) > 500
    assert each_flip(take / "take.parquet", rows) > 500
    assert each_flip(take / "take.mcap", recorded) > 500


def test_a_flipped_bit_of_each_row_group_is_found(
    daemon: Daemon, create: Callable[..., jostle.Swarm], client: jostle.Client, tmp_path: Path
) -> None:
    path, flipped = tmp_path / "take.parquet", tmp_path / "flipped.parquet"
    # A row group has 65,536 rows or a few more.
    record(daemon, client, create(n=700, rate=None, publish_every=1), 100, path)
    whole, metadata = path.read_bytes(), pq.read_metadata(path)
    assert metadata.num_row_groups == 2
    for index in range(metadata.num_row_groups):
        column = metadata.row_group(index).column(metadata.schema.names.index("x"))
        place = column.data_page_offset + column.total_compressed_size // 2
        flipped.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        # pandas does not check it, and returns other data.
        assert not pd.read_parquet(flipped).equals(pd.read_parquet(path))
        for read in (rows, recorded):
            with pytest.raises(jostle.InvalidArgument, match=r"flipped\.parquet"):
                read(flipped)


def test_a_table_is_what_pandas_reads(results: Path) -> None:
    for name in TABLES:
        path = results / f"{name}.parquet"
        pd.testing.assert_frame_equal(jostle.read_table(path), pd.read_parquet(path))
        assert b"jostle.blake3" in pq.read_metadata(path).metadata
    with pytest.raises(FileNotFoundError):
        jostle.read_table(results / "nothing.parquet")
    for content in (b"", b"PAR1", b"PAR1" * 3, b"no table"):
        (results / "other.parquet").write_bytes(content)
        with pytest.raises(jostle.InvalidArgument, match=r"other\.parquet"):
            jostle.read_table(results / "other.parquet")


def test_the_checksums_are_those_that_the_documentation_describes(results: Path) -> None:
    path = results / "series.parquet"
    whole = path.read_bytes()
    text = pq.read_metadata(path).metadata[b"jostle.blake3"].decode()
    footer, *groups = text.split(" ")
    begin = 0
    for group in groups:
        end, digits = group.split(":")
        assert blake3(whole[begin : int(end)]).hexdigest() == digits
        begin = int(end)
    digits = footer.removeprefix("footer:")
    rest = whole[begin:].replace(digits.encode(), b"0" * 64)
    assert blake3(rest).hexdigest() == digits
    assert len(groups) == pq.read_metadata(path).num_row_groups > 0


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_files_without_checksums_raise_no_error_of_a_library(
    take: Path, compression: CompressionType
) -> None:
    path = take / "plain.mcap"
    with (take / "take.mcap").open("rb") as source, path.open("wb") as target:
        reader = mcap.reader.make_reader(source)
        writer = Writer(target, compression=compression, enable_crcs=False, enable_data_crcs=False)
        writer.start()
        channels: dict[str, int] = {}
        for _, channel, message in reader.iter_messages():
            if channel.topic not in channels:
                encoding = channel.message_encoding
                channels[channel.topic] = writer.register_channel(channel.topic, encoding, 0)
            writer.add_message(
                channels[channel.topic], message.log_time, message.data, message.publish_time
            )
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()  # type: ignore[no-untyped-call]
    assert each_flip(path, recorded, 12 * EVERY + 1, is_checked=False) > 10
    whole = path.read_bytes()
    # The length of the value has four bytes.
    number = whole.rindex(b"frames") + len(b"frames") + 4
    assert whole[number : number + 1].isdigit()
    path.write_bytes(whole[:number] + b"'" + whole[number + 1 :])
    with pytest.raises(jostle.InvalidArgument, match=r"plain\.mcap"):
        jostle.read_recording(path)
    plain = take / "plain.parquet"
    pq.write_table(pq.read_table(take / "take.parquet"), plain)
    assert each_flip(plain, recorded, 12 * EVERY + 1, is_checked=False) > 10


def test_a_few_bytes_are_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "few.mcap"
    whole = (ROOT / "tests/stored/bf41dde/filmed.mcap").read_bytes()
    for length in range(40):
        path.write_bytes(whole[:length])
        with pytest.raises(jostle.InvalidArgument, match=r"few\.mcap"):
            jostle.read_recording(path)


def test_the_metadata_of_a_recording_are_its_own(take: Path) -> None:
    about = jostle.read_recording(take / "take.parquet").about
    assert json.loads(about["spec"])["n"] == 3
    assert "jostle.blake3" not in about

"""One damaged place of a ROS recording costs the frames that stand there, wherever it is; nothing fills the memory."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

import cv2
import mcap_writer
import numpy as np
import pytest
from damaged_bags import database, sound
from fuzz import bombs, recorded, structures
from fuzz.promise import limits

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.datasets.bags.pages import Pages
from idrgbdo_torch.datasets.images import read_labels
from idrgbdo_torch.datasets.packed import unpacked
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import BrokenFrame

PAGE = 4096
FRAMES = recorded.FRAMES


def damaged(data: bytes, begin: int, end: int) -> bytes:
    """The data with bytes that are zeros, ones or noise, in turn."""
    size = end - begin
    rng = np.random.default_rng(begin)
    return data[:begin] + (bytes(size), b"\xff" * size, rng.bytes(size))[rng.integers(3)] + data[end:]


def test_no_page_of_a_database_costs_more_than_its_rows(tmp_path: Path) -> None:
    """Those of the schema, the topics and the inner pages of tables and indexes included."""
    name, data = database()
    kinds = {data[at + (100 if at == 0 else 0)] for at in range(0, len(data), PAGE)}
    assert {2, 5, 10, 13} & kinds >= {5, 10, 13}  # inner and leaf pages of tables, leaf pages of indexes
    for at in range(0, len(data), PAGE):
        leads = at == 0 or data[at] in (2, 5, 10)  # to others, and holds no rows of messages
        found, warnings = sound({name: damaged(data, at, at + PAGE)}, tmp_path)
        assert len(found) >= (FRAMES if leads else FRAMES - 2), f"page {at // PAGE}"
        assert len(found) == FRAMES or any("left out" in warning for warning in warnings)


def test_rows_by_page_are_those_of_the_database(tmp_path: Path) -> None:
    _, data = database()
    (tmp_path / "a.db3").write_bytes(data)
    pages = Pages(tmp_path / "a.db3")
    connection = sqlite3.connect(tmp_path / "a.db3")
    rows = connection.execute("SELECT id, topic_id, timestamp, data FROM messages").fetchall()
    assert sorted(pages.rows) == [number for number, *_ in rows] and len(rows) == 3 * FRAMES
    for number, topic, time, content in rows:
        assert (pages.rows[number].topic, pages.rows[number].time) == (topic, time)
        assert pages.data(number) == content
    topics = connection.execute("SELECT id, name, type FROM topics").fetchall()
    assert pages.topics == {number: (topic, kind) for number, topic, kind in topics}
    connection.close()
    pages.close()


@pytest.mark.parametrize("kind", ["mcap recorder zstd", "mcap recorder lz4", "mcap recorder no chunks"])
def test_what_stands_behind_the_messages_of_an_mcap_costs_nothing(kind: str, tmp_path: Path) -> None:
    """Footer, summary, indexes, counts: damaged, or lying about where things are."""
    data = recorded.bag_of(kind)["made.mcap"]
    places = mcap_writer.places(data)
    (behind,) = (begin for number, begin, _ in places if number == mcap_writer.DATA_END)
    for at in range(behind, len(data), 48):
        bad = damaged(data, at, min(at + 48, len(data)))
        assert sound({"made.mcap": bad}, tmp_path)[0] == list(range(FRAMES))
    assert sound({"made.mcap": data[:behind]}, tmp_path)[0] == list(range(FRAMES))
    begins = {number: begin for number, begin, _ in places}
    for number in {mcap_writer.FOOTER, mcap_writer.CHUNK_INDEX, mcap_writer.STATISTICS} & set(begins):
        for where in (9, 17, 25):
            for value in (0, len(data) // 2, 1 << 62):
                at = begins[number] + where
                bad = data[:at] + struct.pack("<Q", value) + data[at + 8 :]
                assert sound({"made.mcap": bad}, tmp_path)[0] == list(range(FRAMES))


@pytest.mark.parametrize("kind", ["mcap recorder", "mcap recorder zstd", "mcap recorder lz4"])
def test_a_damaged_chunk_of_an_mcap_costs_its_messages(kind: str, tmp_path: Path) -> None:
    """A chunk holds the three messages of a frame; its head, its content, and both."""
    data = recorded.bag_of(kind)["made.mcap"]
    chunks = [place for place in mcap_writer.places(data) if place[0] == mcap_writer.CHUNK]
    for number, (_, begin, end) in enumerate(chunks):
        for a, b in ((begin, begin + 9), (begin + 9, begin + 60), ((begin + end) // 2, end), (begin, end)):
            found, warnings = sound({"made.mcap": damaged(data, a, b)}, tmp_path)
            assert set(found) >= set(range(FRAMES)) - {number}
            assert number in found or any("left out" in warning for warning in warnings)


@pytest.mark.parametrize("kind", ["ros1", "ros1 bz2", "ros1 lz4"])
def test_a_damaged_index_of_a_bag_costs_nothing(kind: str, tmp_path: Path) -> None:
    data = recorded.bag_of(kind)["made.bag"]
    (at,) = struct.unpack_from("<Q", data, data.index(b"index_pos=") + len(b"index_pos="))
    for begin in range(at, len(data), 96):
        bad = damaged(data, begin, min(begin + 96, len(data)))
        assert sound({"made.bag": bad}, tmp_path)[0] == list(range(FRAMES))
    assert sound({"made.bag": data[:at]}, tmp_path)[0] == list(range(FRAMES))


def test_names_of_topics_that_are_lost_are_told_by_what_is_in_them(tmp_path: Path) -> None:
    name, data = database()
    page = data.index(b"/camera/color/image_rawsensor_msgs/msg/Image") // PAGE * PAGE
    found, warnings = sound({name: data[:page] + bytes(PAGE) + data[page + PAGE :]}, tmp_path)
    assert found == list(range(FRAMES))
    assert any("are /color/camera_info, /color/image_raw, /depth/image_raw" in warning for warning in warnings)


@pytest.mark.parametrize("door", structures.DOORS)
def test_nothing_unpacks_to_gigabytes(door: str, tmp_path: Path) -> None:
    for seed in range(2):
        (tmp_path / str(seed)).mkdir()
        path = structures.DOORS[door](np.random.default_rng(seed), tmp_path / str(seed))
        with limits(60, 400 << 20):
            try:
                list(open_sequence(path))
            except IdRgbdoError as error:
                assert "\n" not in str(error) and str(path) in str(error)


def test_images_of_many_layers_or_large_tiles_are_refused(tmp_path: Path) -> None:
    path = recorded.write(recorded.folder_of("arrays"), tmp_path)
    bombs.exr_bomb(path / "depth" / "2.exr")
    (path / "depth" / "3.tiff").write_bytes(bombs.tiff_bomb())
    with limits(10, 300 << 20):
        reasons = [frame.reason for frame in open_sequence(path) if isinstance(frame, BrokenFrame)]
    assert len(reasons) == 2 and "got 90 million numbers in 1 parts" in reasons[0] and "16384x16384" in reasons[1]


def test_a_phones_archive_of_endless_folders_is_refused(tmp_path: Path) -> None:
    parts = {f"{k}/" * 30_000 + "a": b"" for k in range(9)}
    path = bombs.archive_of({"metadata": b"{}", **parts}, tmp_path / "a.r3d")
    with limits(10, 100 << 20), pytest.raises(IdRgbdoError, match="folders in folders in folders"):
        open_sequence(path)


def test_a_confidence_of_any_size_is_no_confidence(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(bombs.png_bomb((30_000, 30_000), color=True))
    with limits(10, 100 << 20):
        assert read_labels(tmp_path / "a.png") is None
    cv2.imwrite(str(tmp_path / "b.png"), np.full((192, 256), 2, np.uint8))
    labels = read_labels(tmp_path / "b.png")
    assert labels is not None and labels.shape == (192, 256) and (labels == 2).all()


def test_a_refused_chunk_says_by_how_much(tmp_path: Path) -> None:
    whole = recorded.bag_of("mcap recorder zstd")["made.mcap"]
    for size, words in ((100, "more than 100 bytes"), (3 << 30, "a piece of 3072 MB, more than 256 MB")):
        found, warnings = sound({"made.mcap": bombs.mcap_with("zstd", size, whole)}, tmp_path)
        assert found == [0, 1, 3, 4, 5] and any(words in warning for warning in warnings)
    many = mcap_writer.write_mcap(mcap_writer.messages(recorded.film()) * 2, "zstd")
    for _ in range(4):  # of 200 MB each, which is more than a recording of this size unpacks to
        many = bombs.mcap_with("zstd", 200 << 20, many, replace=False)
    with pytest.raises(IdRgbdoError, match=r"unpack to 8\d\d MB, which no recording does"):
        sound({"made.mcap": many}, tmp_path)


def test_lzfse_is_believed_no_further_than_its_blocks(tmp_path: Path) -> None:
    import lzfse

    depth = np.random.default_rng(0).normal(2, 0.1, (480, 640)).astype(np.float32).tobytes()
    packed = lzfse.compress(depth)
    assert packed.count(b"bvx2") > 8 and unpacked(packed, "here") == depth
    for end in (0, 20, len(packed) // 2, len(packed) - 1):
        with pytest.raises(IdRgbdoError, match="here: cannot unpack"):
            unpacked(packed[: max(end, 4)], "here")


def test_a_row_that_has_become_another_one_is_said(tmp_path: Path) -> None:
    name, data = database()
    pages = [at for at in range(8 * PAGE, len(data), PAGE) if data[at] == 13 and data[at + 4] >= 2]
    nothing = struct.pack(">H", 8 + 2 * data[pages[0] + 4] + 20)  # a place between the cells and their list
    found, warnings = sound({name: data[: pages[0] + 10] + nothing + data[pages[0] + 12 :]}, tmp_path)
    assert len(found) >= FRAMES - 1 and any("17 of its 18 rows are messages" in warning for warning in warnings)


def test_a_schema_that_is_no_text_costs_nothing(tmp_path: Path) -> None:
    name, data = database()
    at = data.index(b"tablemessagesmessages") + 8
    found, warnings = sound({name: data[:at] + b"\x8b" + data[at + 1 :]}, tmp_path)
    assert found == list(range(FRAMES)) and any("18 rows are left" in warning for warning in warnings)


def test_a_topic_that_nothing_leads_to_is_found_again(tmp_path: Path) -> None:
    name, data = database()
    page = data.index(b"/camera/color/image_rawsensor_msgs/msg/Image") // PAGE * PAGE
    assert data[page] == 13 and data[page + 4] == 3
    for cell in range(3):
        at = page + 8 + 2 * cell
        found, warnings = sound({name: data[:at] + b"\x07\x00" + data[at + 2 :]}, tmp_path)
        assert found == list(range(FRAMES)) and any("1 of which were found again" in said for said in warnings)


@pytest.mark.parametrize("kind", ["ros1 lz4", "ros1"])
def test_a_header_of_a_bag_that_lies_about_its_length_costs_nothing(kind: str, tmp_path: Path) -> None:
    """It may lead into the middle of any chunk."""
    data = recorded.bag_of(kind)["made.bag"]
    _, begin, _ = bombs.bag_places(data)[0]
    (head,) = struct.unpack_from("<I", data, begin)
    at = begin + 4 + head
    for length in (0, 5000, 0x8FB3, len(data) - at - 100):
        bad = data[:at] + struct.pack("<I", length) + data[at + 4 :]
        assert sound({"made.bag": bad}, tmp_path)[0] == list(range(FRAMES))


def test_a_root_that_has_become_another_page_costs_nothing(tmp_path: Path) -> None:
    name, data = database()
    leaf = next(at for at in range(6 * PAGE, len(data), PAGE) if data[at] == 13)
    bad = data[: 5 * PAGE] + data[leaf : leaf + PAGE] + data[6 * PAGE :]
    assert data[5 * PAGE] == 5 and sound({name: bad}, tmp_path)[0] == list(range(FRAMES))


def test_a_page_that_has_become_another_one_is_said(tmp_path: Path) -> None:
    """Also one that leads to others, and the one of the topics, which may become one of another table."""
    name, data = database()
    leading = [at for at in range(0, len(data), PAGE) if at == 0 or (data[at] in (2, 5, 10, 13) and data[at + 4] >= 2)]
    assert len(leading) >= 8
    for begin in leading:
        for other in leading:
            if other != begin:
                bad = data[:begin] + data[other : other + PAGE] + data[begin + PAGE :]
                found, warnings = sound({name: bad}, tmp_path)
                assert len(found) >= FRAMES - structures.LOST
                assert len(found) == FRAMES or any("left out" in warning for warning in warnings)


def test_no_byte_of_the_head_of_a_database_costs_anything(tmp_path: Path) -> None:
    """It tells the size of the pages, and how much of each is used."""
    name, data = database()
    for at in range(24):
        for value in (0, 73, 255):
            bad = data[:at] + bytes([value, data[at + 1] ^ 12]) + data[at + 2 :]
            assert sound({name: bad}, tmp_path)[0] == list(range(FRAMES)), f"byte {at}"

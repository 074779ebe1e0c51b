"""Topics of ROS recordings whose name, type or number is damaged, and images that are none of theirs."""

from __future__ import annotations

from pathlib import Path

import bag_writer
import mcap_writer
import pytest
from damaged_bags import database, sound
from fuzz import recorded

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.frame import RgbdFrame

FRAMES = recorded.FRAMES


TOPICS = (
    ("/camera/aligned_depth_to_color/image_raw", "sensor_msgs/msg/Image"),
    ("/camera/color/image_raw", "sensor_msgs/msg/Image"),
    ("/camera/color/camera_info", "sensor_msgs/msg/CameraInfo"),
)


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_no_byte_of_a_topic_costs_it(topic: str, kind: str, tmp_path: Path) -> None:
    """Its name, its type, its number: what is in its messages tells what it is, and the camera is the same one."""
    name, data = database()
    begin = data.index(f"{topic}{kind}".encode())
    camera = open_sequence(recorded.write({name: data}, tmp_path)).camera
    for at in range(begin - 9, begin + len(topic) + len(kind), 5):
        for byte in (data[at] ^ 1, data[at] ^ 128):
            bad = data[:at] + bytes([byte]) + data[at + 1 :]
            assert sound({name: bad}, tmp_path)[0] == list(range(FRAMES)), f"byte {at - begin}"
            assert open_sequence(tmp_path / "made").camera == camera


def test_a_topic_of_another_type_keeps_its_name(tmp_path: Path) -> None:
    name, data = database()
    topic = b"/camera/aligned_depth_to_color/image_raw"
    at = data.index(topic + b"sensor_msgs/msg/Image") + len(topic) + 5
    bad = data[:at] + b"n" + data[at + 1 :]
    found, warnings = sound({name: bad}, tmp_path)
    assert found == list(range(FRAMES))
    assert warnings[1:] == [  # the first one is of metadata.yaml
        "topics whose name or type is lost are images or calibrations by what is in them: "
        "/camera/aligned_depth_to_color/image_raw"
    ]


def test_an_image_that_is_astray_is_said(tmp_path: Path) -> None:
    """A message of a topic that nothing names, of the topic of the other images, or with another time."""
    data = recorded.bag_of("mcap recorder no chunks")["made.mcap"]
    messages = [begin for kind, begin, _ in mcap_writer.places(data) if kind == mcap_writer.MESSAGE]
    for number in (0, 1, 9, 10, 3 * FRAMES - 3):
        at = messages[number]
        for place, value in (
            (at + 9, b"\x07"),
            (at + 9, bytes([3 - data[at + 9]])),
            (at + 9 + 22 + 5, b"\x11"),
            (at + 9 + 22 + 11, bytes([data[at + 9 + 22 + 11] ^ 16])),  # 0.27 s
        ):
            found, warnings = sound({"made.mcap": data[:place] + value + data[place + 1 :]}, tmp_path)
            assert found == [frame for frame in range(FRAMES) if frame != number // 3]
            assert any("1 damaged images" in warning and "left out" in warning for warning in warnings)


def test_depth_of_any_name_is_told_by_what_is_in_it(tmp_path: Path) -> None:
    topics = ("/left/image_raw", "/left/image_range")
    sequence = open_sequence(bag_writer.write_bag(recorded.film(), tmp_path / "a.bag", topics=topics))
    assert sum(isinstance(frame, RgbdFrame) for frame in sequence) == FRAMES
    assert "no topic is called depth; by what is in it, /left/image_range is" in sequence.warnings


def test_a_name_that_is_another_in_one_of_its_places_is_that_of_the_other_place(tmp_path: Path) -> None:
    data = recorded.bag_of("mcap recorder no chunks")["made.mcap"]
    camera = open_sequence(recorded.write({"made.mcap": data}, tmp_path)).camera
    for name in (b"/camera/color/image_raw", b"/camera/color/camera_info"):
        assert data.count(name) >= 2
        for begin in (data.index(name), data.rindex(name)):
            for at in range(begin, begin + len(name), 5):
                bad = data[:at] + bytes([data[at] ^ 32]) + data[at + 1 :]
                assert sound({"made.mcap": bad}, tmp_path)[0] == list(range(FRAMES))
                assert open_sequence(tmp_path / "made.mcap").camera == camera


def test_a_name_that_is_another_in_one_of_the_files_is_that_of_the_others(tmp_path: Path) -> None:
    messages = mcap_writer.messages(recorded.film())
    files = {f"made/made_{k}.mcap": mcap_writer.write_mcap(messages[9 * k : 9 * k + 9], "", 0) for k in range(2)}
    assert sound(files, tmp_path)[0] == list(range(FRAMES))
    for name in (b"/camera/color/image_raw", b"/camera/aligned_depth_to_color/image_raw", b"/camera/color/camera_info"):
        for chosen, data in files.items():
            bad = data.replace(name, name[:9] + b"#" + name[10:])
            found, warnings = sound({**files, chosen: bad}, tmp_path)
            assert found == list(range(FRAMES)) and any("of one of the files is taken for" in said for said in warnings)

"""The rendered world: exact geometry, consistent light, a sensor whose parts switch, and TUM's layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from rendered import clearance

from idrgbdo_torch.datasets import open_sequence
from idrgbdo_torch.errors import IdRgbdoError
from idrgbdo_torch.frame import RgbdFrame
from idrgbdo_torch.synthetic import KINDS, RenderedSequence, SensorConfig, SynthConfig, synth
from idrgbdo_torch.synthetic.config import Kind
from idrgbdo_torch.synthetic.paths import rotation_matrix
from idrgbdo_torch.synthetic.render import Depth, sub_pixels
from idrgbdo_torch.synthetic.sensor import develop, exposure_gain, measure

SMALL = SynthConfig(frames=8, width=160, height=120, fx=131.25, fy=131.25, cx=79.5, cy=59.5)


def ideal(kind: Kind = "desk", seed: int = 0, size: int = 1) -> SynthConfig:
    """A small noise-free sequence; size scales the image."""
    s = float(size)
    return replace(
        SMALL,
        kind=kind,
        seed=seed,
        width=160 * size,
        height=120 * size,
        fx=131.25 * s,
        fy=131.25 * s,
        cx=80 * s - 0.5,
        cy=60 * s - 0.5,
        sensor=SensorConfig.ideal(),
    )


@pytest.fixture(scope="module")
def exact() -> RenderedSequence:
    return RenderedSequence(ideal(size=2))


def warp(sequence: RenderedSequence, i: int, j: int) -> tuple[npt.NDArray[np.float32], ...]:
    """Pixels of frame i in frame j: their (u, v) maps and depth there, by ground truth and the depth file."""
    c = sequence.config
    z = sequence.shot(i).depth / 5000.0
    u, v = np.meshgrid(np.arange(c.width), np.arange(c.height))
    P = np.stack([(u - c.cx) / c.fx * z, (v - c.cy) / c.fy * z, z], -1)
    T = np.linalg.inv(sequence.T_world_cam[j]) @ sequence.T_world_cam[i]
    Q = P @ T[:3, :3].T + T[:3, 3]
    u, v = Q[..., 0] / Q[..., 2] * c.fx + c.cx, Q[..., 1] / Q[..., 2] * c.fy + c.cy
    return u.astype(np.float32), v.astype(np.float32), Q[..., 2].astype(np.float32)


def test_depth_of_one_frame_is_the_depth_of_the_next(exact: RenderedSequence) -> None:
    u, v, z = warp(exact, 0, 7)
    there = exact.shot(7).depth.astype(np.float32) / 5000.0
    seen = cv2.remap(there, u, v, cv2.INTER_LINEAR, borderValue=0)
    inside = (u > 0) & (v > 0) & (u < exact.config.width - 1) & (v < exact.config.height - 1)
    difference = np.abs(seen - z)[inside]
    assert inside.mean() > 0.6
    assert np.abs(exact.T_world_cam[7, :3, 3] - exact.T_world_cam[0, :3, 3]).max() > 0.01  # it did move
    assert np.median(difference) < 0.0005
    assert np.percentile(difference, 80) < 0.002


def test_light_of_one_frame_is_the_light_of_the_next(exact: RenderedSequence) -> None:
    u, v, z = warp(exact, 0, 7)
    a, b = (cv2.cvtColor(exact.shot(k).color, cv2.COLOR_RGB2GRAY).astype(np.float32) for k in (0, 7))
    seen_depth = cv2.remap(exact.shot(7).depth.astype(np.float32) / 5000.0, u, v, cv2.INTER_NEAREST, borderValue=0)
    same = np.abs(seen_depth - z) < 0.02
    at_truth = np.abs(cv2.remap(b, u, v, cv2.INTER_LINEAR) - a)[same]
    shifted = np.abs(cv2.remap(b, u + 1, v, cv2.INTER_LINEAR) - a)[same]
    assert same.mean() > 0.5
    assert np.median(at_truth) < 1.5
    assert at_truth.mean() < 0.4 * shifted.mean()


def test_no_bias_between_colour_and_depth_positions(exact: RenderedSequence) -> None:
    """The mean residual is smallest at the true place, to a twentieth of a pixel, in both directions."""
    u, v, z = warp(exact, 0, 7)
    a, b = (cv2.cvtColor(exact.shot(k).color, cv2.COLOR_RGB2GRAY).astype(np.float32) for k in (0, 7))
    seen_depth = cv2.remap(exact.shot(7).depth.astype(np.float32) / 5000.0, u, v, cv2.INTER_NEAREST, borderValue=0)
    same = np.abs(seen_depth - z) < 0.02
    for du, dv in ((1.0, 0.0), (0.0, 1.0)):
        cost = [
            np.minimum((cv2.remap(b, u + s * du, v + s * dv, cv2.INTER_LINEAR) - a)[same] ** 2, 400.0).mean()
            for s in (-0.5, 0.0, 0.5)
        ]
        best = 0.25 * (cost[0] - cost[2]) / (cost[0] - 2 * cost[1] + cost[2])
        assert abs(best) < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_closed_clear_of_the_camera_and_at_indoor_distance(kind: Kind) -> None:
    sequence = RenderedSequence(ideal(kind, seed=3))
    depth = sequence.shot(4).depth / 5000.0
    assert (depth > 0).all()
    assert 0.5 < np.median(depth) < 3.0
    assert np.mean(depth < 4.5) > 0.95
    path = (sequence.T_scene_world @ sequence.T_world_cam)[:, :3, 3]
    assert clearance(sequence.renderer.world, path).min() > 0.5
    assert 70 < sequence.shot(4).color.mean() < 170


def test_texture_is_where_its_name_says() -> None:
    def edges(kind: Kind) -> float:
        gray = cv2.cvtColor(RenderedSequence(ideal(kind, seed=1, size=2)).shot(3).color, cv2.COLOR_RGB2GRAY)
        return float((cv2.Canny(gray, 50, 200) > 0).mean())

    rich = min(edges(kind) for kind in ("desk", "structure_texture", "nostructure_texture"))
    poor = max(edges(kind) for kind in ("structure_notexture", "poor"))
    assert rich > 0.04
    assert poor < 0.25 * rich


def test_the_plane_is_flat_and_the_structure_is_not() -> None:
    def spread(kind: Kind) -> float:
        """Departure of inverse depth from the best plane (inverse depth of a plane is affine in the pixel)."""
        inverse = 5000.0 / RenderedSequence(ideal(kind, seed=2)).shot(0).depth
        v, u = np.mgrid[: inverse.shape[0], : inverse.shape[1]]
        A = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], 1)
        fit = np.linalg.lstsq(A, inverse.ravel(), rcond=None)[0]
        return float(np.median(np.abs(A @ fit - inverse.ravel())))

    assert spread("nostructure_texture") < 1e-3
    assert spread("structure_notexture") > 0.02


def test_same_bits_in_any_order_and_other_bits_with_another_seed() -> None:
    first, second = RenderedSequence(SMALL), RenderedSequence(SMALL)
    late = first.shot(5)
    _ = second.shot(0)
    assert np.array_equal(late.color, second.shot(5).color)
    assert np.array_equal(late.depth, second.shot(5).depth)
    assert not np.array_equal(late.color, RenderedSequence(replace(SMALL, seed=1)).shot(5).color)


def test_frames_are_what_the_folder_holds(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    config = replace(SMALL, frames=3)
    sequence = synth(config, tmp_path / "s", lambda done, of: seen.append((done, of)))
    folder = tmp_path / "s"
    assert seen == [(1, 3), (2, 3), (3, 3)]
    rows = [line.split() for line in (folder / "associations.txt").read_text().splitlines()]
    assert [float(row[0]) for row in rows] == pytest.approx(sequence.timestamps, abs=1e-9)
    color = cv2.cvtColor(cv2.imread(str(folder / rows[1][1])), cv2.COLOR_BGR2RGB)
    depth = cv2.imread(str(folder / rows[1][3]), cv2.IMREAD_UNCHANGED)
    frame = sequence.read(1)
    assert frame.color is not None
    assert np.array_equal(frame.color.numpy(), color)
    assert depth.dtype == np.uint16
    assert np.array_equal(frame.depth.numpy(), depth.astype(np.float32) / np.float32(5000))
    assert np.abs(frame.gray.numpy() - color @ [0.299, 0.587, 0.114]).max() < 1e-3
    truth = np.loadtxt(folder / "groundtruth.txt")
    assert np.allclose(truth[:, 1:4], sequence.T_world_cam[:, :3, 3], atol=1e-9)
    assert np.allclose(rotation_matrix(truth[:, 4:]), sequence.T_world_cam[:, :3, :3], atol=1e-9)
    assert np.allclose(sequence.groundtruth.T_world_cam.numpy(), sequence.T_world_cam)
    assert (folder / "calibration.txt").read_text() == "131.25 131.25 79.5 59.5\n"
    for name in ("rgb", "depth"):
        lines = [line for line in (folder / f"{name}.txt").read_text().splitlines() if not line.startswith("#")]
        assert all((folder / line.split()[1]).exists() for line in lines)
        assert len(lines) == 3
    again = open_sequence(folder)
    assert again.timestamps == pytest.approx(sequence.timestamps, abs=1e-9)
    assert again.camera == sequence.camera
    back = again.read(1)
    assert isinstance(back, RgbdFrame)
    assert float((back.gray - frame.gray).abs().max()) < 1e-4
    assert float((back.depth - frame.depth).abs().max()) < 1e-6
    with pytest.raises(IdRgbdoError, match="out: expected a new folder"):
        synth(config, folder)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "camera.toml").write_text("mine")  # of a folder of images
    with pytest.raises(IdRgbdoError, match=r"got '.*mine' with a 'camera\.toml'"):
        synth(config, tmp_path / "mine")


def flat(z: float = 1.0) -> Depth:
    """A wall across the view."""
    return Depth(depth=np.full((240, 320), z, np.float32), cosine=np.ones((240, 320), np.float32))


def test_depth_noise_quantisation_and_range() -> None:
    rng = np.random.default_rng(0)
    quiet = SensorConfig.ideal()
    assert (measure(flat(), quiet, rng) == 5000).all()
    noisy = measure(flat(), replace(quiet, depth_noise=True), rng) / 5000.0
    disparity = 40.0 / noisy
    assert disparity.std() == pytest.approx(0.12, rel=0.1)
    assert abs(disparity.mean() - 40.0) < 0.01
    neighbours = np.corrcoef(disparity[:, 1:].ravel(), disparity[:, :-1].ravel())[0, 1]
    assert 0.6 < neighbours < 0.95  # correlated over a few pixels
    assert abs(np.corrcoef(disparity[:, 12:].ravel(), disparity[:, :-12].ravel())[0, 1]) < 0.1
    steps = 40.0 / (measure(flat(3.0), replace(quiet, depth_noise=True, depth_quantisation=True), rng) / 5000.0)
    assert np.abs(steps * 8 - np.round(steps * 8)).max() < 0.01
    ranged = replace(quiet, depth_range=True)
    assert [int((measure(flat(z), ranged, rng) > 0).all()) for z in (0.4, 0.6, 4.4, 4.6)] == [0, 1, 1, 0]


def test_depth_holes_lie_at_edges_on_the_shadow_side_and_at_grazing_angles() -> None:
    scene = flat(2.0)
    scene.depth[:, 150:200] = 1.0  # disparity 40 in front of 20: a shadow of 20 px on the left
    scene.cosine[:20] = 0.05
    valid = measure(scene, replace(SensorConfig.ideal(), depth_holes=True), np.random.default_rng(0)) > 0
    assert valid[25:, 132:148].mean() < 0.05
    assert valid[25:, 100:125].all()
    assert valid[25:, 155:195].all()
    assert valid[25:, 204:300].all()
    assert valid[:20].mean() < 0.03


def test_colour_noise_at_mid_gray_and_exposure_drift() -> None:
    rng = np.random.default_rng(0)
    gray = np.full((200, 200, 3), 0.5**2.2, np.float32)
    quiet = SensorConfig.ideal()
    assert np.ptp(develop(gray, 1.0, quiet, rng)) == 0
    noisy = develop(gray, 1.0, replace(quiet, color_noise=True), rng).astype(float)
    assert noisy.std() == pytest.approx(2.2, rel=0.1)
    assert noisy.mean() == pytest.approx(127.5, abs=0.3)
    drifting = replace(quiet, exposure_drift=True)
    gains = [exposure_gain(t, drifting, 0) for t in np.arange(0, 30, 0.1)]
    assert 0.9 <= min(gains) < 0.97
    assert 1.03 < max(gains) <= 1.1
    assert np.abs(np.diff(gains)).max() < 0.02  # slow
    assert exposure_gain(3.0, quiet, 0) == 1.0


def test_motion_blur_softens_a_fast_frame() -> None:
    def sharpness(exposure_s: float) -> float:
        sensor = replace(SensorConfig.ideal(), motion_blur=True, exposure_s=exposure_s)
        gray = cv2.cvtColor(RenderedSequence(replace(ideal(size=2), sensor=sensor)).shot(5).color, cv2.COLOR_RGB2GRAY)
        return float(cv2.Laplacian(gray, cv2.CV_32F).var())

    assert sharpness(0.08) < 0.7 * sharpness(0.0005)


def test_sub_pixel_offsets_have_no_bias() -> None:
    for samples in range(1, 13):
        offsets = sub_pixels(samples)
        assert offsets.shape == (samples, 2)
        assert np.abs(offsets.mean(0)).max() < 1e-12
        assert np.abs(offsets).max() < 0.75


def test_any_recorded_trajectory_fits_its_room(data_dir: Path) -> None:
    files = sorted((data_dir / "trajectories" / "groundtruth").glob("*.txt"))
    assert files
    for file in files[::3]:
        sequence = RenderedSequence(replace(ideal("desk"), trajectory=file, frames=120, start=1.0))
        path = (sequence.T_scene_world @ sequence.T_world_cam)[:, :3, 3]
        assert clearance(sequence.renderer.world, path).min() > 0.5
        depth = sequence.shot(60).depth / 5000.0
        assert (depth > 0).all()
        assert np.mean((depth > 0.5) & (depth < 4.5)) > 0.9

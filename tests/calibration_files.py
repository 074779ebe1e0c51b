"""The same camera as other programs and people write it down, and what is read of it."""

from __future__ import annotations

import json

K = (262.5, 263.5, 159.5, 119.25)
MATRIX = "262.5, 0., 159.5, 0., 263.5, 119.25, 0., 0., 1."
COLUMNS = [262.5, 0, 0, 0, 263.5, 0, 159.5, 119.25, 1]
D5 = (0.1, -0.2, 0.001, 0.002, 0.05)
REALSENSE = {"width": 320, "height": 240, "fx": 262.5, "fy": 263.5, "ppx": 159.5, "ppy": 119.25}

FILES: dict[str, tuple[str, dict[str, object]]] = {
    "orbslam.yaml": (
        "%YAML:1.0\n\n# Camera\nCamera.fx: 262.5\nCamera.fy: 263.5\nCamera.cx: 159.5\nCamera.cy: 119.25\n"
        "Camera.k1: 0.1\nCamera.k2: -0.2\nCamera.p1: 0.001\nCamera.p2: 0.002\nCamera.k3: 0.05\nCamera.width: 320\n"
        "Camera.height: 240\nCamera.fps: 30.0\nCamera.RGB: 1\nDepthMapFactor: 5000.0\nViewer.ViewpointF: 500\n",
        {"D": D5, "size": (320, 240), "depth_scale": 5000.0, "fps": 30.0},
    ),
    "orbslam3.yaml": (
        '%YAML:1.0\nFile.version: "1.0"\nCamera.type: "PinHole"\nCamera1.fx: 262.5\nCamera1.fy: 263.5\n'
        "Camera1.cx: 159.5\nCamera1.cy: 119.25\nCamera2.fx: 99.\nStereo.b: 0.07\nRGBD.DepthMapFactor: 1000.0\n",
        {"depth_scale": 1000.0},
    ),
    "ost.yaml": (
        "image_width: 320\nimage_height: 240\ncamera_name: narrow\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        f"  data: [{MATRIX}]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n"
        "  data: [0.1, -0.2, 0.001, 0.002, 0.05]\nrectification_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nprojection_matrix:\n  rows: 3\n  cols: 4\n"
        "  data: [200, 0, 150, 0, 0, 200, 110, 0, 0, 0, 1, 0]\n",
        {"D": D5, "size": (320, 240)},
    ),
    "opencv.yml": (
        '%YAML:1.0\n---\ncalibration_time: "Thu Nov 26 17:22:47 2026"\nimage_width: 320\nimage_height: 240\nflags: 0\n'
        "camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 2.625e+02, 0., 1.595e+02, 0.,\n"
        "       2.635e+02, 1.1925e+02, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n"
        "   dt: d\n   data: [ 0.1, -0.2, 0.001,\n       0.002, 0.05 ]\navg_reprojection_error: 0.3\n",
        {"D": D5, "size": (320, 240)},
    ),
    "echo.yaml": (  # ros2 topic echo
        "header:\n  stamp:\n    sec: 1\n    nanosec: 2\n  frame_id: camera\nheight: 240\nwidth: 320\n"
        "distortion_model: rational_polynomial\nd:\n- 0.1\n- -0.2\n- 0.001\n- 0.002\n- 0.05\n- 0.3\n- 0.4\n- 0.5\n"
        "k:\n- 262.5\n- 0.0\n- 159.5\n- 0.0\n- 263.5\n- 119.25\n- 0.0\n- 0.0\n- 1.0\nbinning_x: 0\n---\n",
        {"D": (*D5, 0.3, 0.4, 0.5), "size": (320, 240)},
    ),
    "kalibr.yaml": (
        "cam0:\n  cam_overlaps: []\n  camera_model: pinhole\n  distortion_coeffs: [0.1, -0.2, 0.001,\n    0.002]\n"
        "  distortion_model: radtan\n  intrinsics: [262.5, 263.5, 159.5, 119.25]\n  resolution: [320, 240]\n"
        "  rostopic: /camera/image\n  T_cam_imu:\n  - [0.0, 1.0, 0.0, 0.1]\n  - [1.0, 0.0, 0.0, 0.2]\n"
        "  - [0.0, 0.0, -1.0, 0.3]\n  - [0.0, 0.0, 0.0, 1.0]\n",
        {"D": D5[:4], "size": (320, 240)},
    ),
    "kalibr_two.yaml": (
        "cam0:\n  camera_model: pinhole\n  intrinsics: [99, 99, 9, 9]\n  rostopic: /camera/infra1/image\n"
        "cam1:\n  camera_model: pinhole\n  intrinsics: [262.5, 263.5, 159.5, 119.25]\n  rostopic: /camera/color/i\n",
        {},
    ),
    "pyyaml.yaml": (  # PyYAML's default style
        f"camera_matrix:\n- - 262.5\n  - 0.0\n  - 159.5\n- - 0.0\n  - 263.5\n  - 119.25\n- - 0.0\n  - 0.0\n  - 1.0\n"
        f"dist_coeff: 0\ndist_coeffs:\n- - {D5[0]}\n  - {D5[1]}\n  - {D5[2]}\n  - {D5[3]}\n  - {D5[4]}\n",
        {"D": D5},
    ),
    "flow.yaml": (f"camera_matrix: {{rows: 3, cols: 3, data: [{MATRIX}]}}\nsize: [320, 240]\n", {"size": (320, 240)}),
    "open3d.json": (
        json.dumps({"width": 320, "height": 240, "intrinsic_matrix": COLUMNS}),
        {"size": (320, 240)},
    ),
    "realsense.json": (
        json.dumps({**REALSENSE, "model": "distortion.inverse_brown_conrady", "coeffs": [0.0] * 5}),
        {"size": (320, 240)},
    ),
    "realsense_streams.json": (
        json.dumps({"depth_scale": 0.0002500000118743628, "depth": {**REALSENSE, "fx": 99.0},
                    "color": {**REALSENSE, "model": "brown_conrady", "coeffs": list(D5)}}),
        {"D": D5, "size": (320, 240), "depth_scale": 4000.0},
    ),
    "metadata": (  # Record3D
        json.dumps({"w": 320, "h": 240, "dw": 192, "dh": 256, "K": COLUMNS, "fps": 60, "poses": [[0.0] * 7]}),
        {"size": (320, 240), "fps": 60.0},
    ),
    "colmap.json": (  # (0, 0) is the corner of the top-left pixel
        json.dumps({"camera_model": "OPENCV", "fx": 262.5, "fy": 263.5, "cx": 160.0, "cy": 119.75}), {},
    ),
    "transforms.json": (  # instant-ngp, the same
        json.dumps({"fl_x": 262.5, "fl_y": 263.5, "cx": 160.0, "cy": 119.75, "w": 320, "h": 240, "scale": 0.33,
                    "k1": 0.1, "k2": -0.2, "p1": 0.001, "p2": 0.002, "frames": []}),
        {"D": D5[:4], "size": (320, 240)},
    ),
    "cam_params.json": (  # Replica
        json.dumps({"camera": {"w": 320, "h": 240, **dict(zip(("fx", "fy", "cx", "cy"), K, strict=True)),
                               "scale": 6553.5}}),
        {"size": (320, 240), "depth_scale": 6553.5},
    ),
    "rows.json": (json.dumps({"K": [[262.5, 0, 159.5], [0, 263.5, 119.25], [0, 0, 1]]}), {}),
    "calib.txt": ("262.5 263.5 159.5 119.25\n", {}),
    "calib8.txt": ("262.5, 263.5, 159.5, 119.25, 0.1 -0.2 0.001 0.002  # radial, tangential\n", {"D": D5[:4]}),
    "calib12.txt": ("262.5 263.5 159.5 119.25 0.1 -0.2 0.001 0.002 0.05 1 2 3", {"D": (*D5, 1, 2, 3)}),
    "K.txt": ("262.5 0 159.5\n0 263.5 119.25\n0 0 1\n", {}),
    "K4.txt": ("262.5 0 159.5 0\n0 263.5 119.25 0\n0 0 1 0\n0 0 0 1\n", {}),
    "P.txt": ("262.5 0 159.5 0\n0 263.5 119.25 0\n0 0 1 0\n", {}),
    "bom.toml": ("\ufefffx = 262.5\r\nfy = 263.5\r\ncx = 159.5\r\ncy = 119.25\r\n", {}),
    "text.toml": ('fx = "262.5"\nfy = 263.5\ncx = 159.5\ncy = 119.25\n', {}),
    "caps.toml": ("FX = 262.5\nFY = 263.5\nCX = 159.5\nCY = 119.25\nK4 = 0.5\n", {"D": (0, 0, 0, 0, 0, 0.5)}),
}  # fmt: skip

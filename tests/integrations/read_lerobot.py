"""Reads LeRobot datasets with LeRobot's own reader, and writes what it finds to npz files.

`python read_lerobot.py LIBRARY DATASET FILE.npz [DATASET FILE.npz ...]`: the folder LIBRARY has lerobot, torchvision,
accelerate and safetensors, installed without what they require (see the Makefile).
"""

import sys
from typing import Any

import numpy as np
import torch

sys.path.append(sys.argv[1])
# torchvision's compiled part is for the PyTorch that lerobot asks for: its Python needs no more than this to exist
operators = torch.library.Library("torchvision", "DEF")
operators.define("nms(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402

for folder, file in zip(sys.argv[2::2], sys.argv[3::2], strict=True):
    dataset = LeRobotDataset("armctl/test", root=folder, video_backend="pyav")
    frames = [dataset[i] for i in range(len(dataset))]
    found: dict[str, Any] = {
        key: np.array([np.asarray(frame[key]) for frame in frames]) for key in frames[0] if key != "task"
    }
    found |= {f"stats/{key}/{name}": value for key, one in dataset.meta.stats.items() for name, value in one.items()}
    np.savez(
        file,
        fps=dataset.fps,
        episodes=dataset.num_episodes,
        tasks=[frame["task"] for frame in frames],
        **found,
    )

"""Cast tables with exact truth: solids, a depth camera, sensor noise, scenes, clearances."""

from __future__ import annotations

from boxgrasp.simulate.camera import CastView, cast
from boxgrasp.simulate.demo import demo_capture, demo_scene
from boxgrasp.simulate.holding import HoldTruth, hold_truth
from boxgrasp.simulate.noise import NoiseModel, add_noise
from boxgrasp.simulate.objects import SimulatedObject, load_objects
from boxgrasp.simulate.primitives import Box, Cylinder, Plane, Primitive, Solids
from boxgrasp.simulate.scenes import Clutter, TableScene, build_scene, draw_scene, to_capture
from boxgrasp.simulate.truth import (
    CandidateTruth,
    TrueCandidates,
    box_clearance,
    candidate_truth,
    true_box,
    true_candidates,
)

__all__ = [
    "Box",
    "CastView",
    "Clutter",
    "Cylinder",
    "NoiseModel",
    "CandidateTruth",
    "HoldTruth",
    "Plane",
    "Primitive",
    "SimulatedObject",
    "Solids",
    "TableScene",
    "TrueCandidates",
    "add_noise",
    "box_clearance",
    "build_scene",
    "cast",
    "demo_capture",
    "demo_scene",
    "draw_scene",
    "hold_truth",
    "load_objects",
    "candidate_truth",
    "to_capture",
    "true_box",
    "true_candidates",
]

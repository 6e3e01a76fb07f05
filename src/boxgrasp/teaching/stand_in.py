"""A stand-in for the thesis's operator: not a person, a rule with a person's habits.

It sees the visible cloud and the box, never the truth. It likes front and top-parallel, since
elsewhere a finger goes to a side that faces away from the camera; it likes central lines; it
takes what looks free, judging distances with a small error; it never asks the fingers to open
wider than they can (thesis 3-3-1, 5-1). Its few numbers were set so that its choices match what
the thesis's text keeps of figures 4-1 and 4-2, on scenes that no result is reported on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.geometry import hand_distance
from boxgrasp.teaching.operators import Label, Shown

SOURCE = "stand-in"


@dataclass(frozen=True)
class StandIn:
    """Its habits; liking is counted in meters of clearance that it makes up for.

    Attributes:
        face_m: liking of left, front, right, top-parallel, top-perpendicular, m.
        off_center_m: what the outermost lines cost, m.
        enough_m: clearance beyond which more is no better, m.
        judgment_sigma_m: standard deviation of its judgment of clearance, m.
        mood_sigma_m: standard deviation of its liking, m.
        into_table_m: how far under the table's top a hand would have to be for it to see that, m.
    """

    face_m: tuple[float, float, float, float, float] = (0.0, 0.042, 0.0, 0.028, 0.012)
    off_center_m: float = 0.018
    enough_m: float = 0.12
    judgment_sigma_m: float = 0.003
    mood_sigma_m: float = 0.002
    into_table_m: float = 0.01

    def label(self, shown: Shown, rng: np.random.Generator) -> Label:
        """The candidate that it likes best.

        Args:
            shown: the scene.
            rng: draws its errors and moods.

        Returns:
            A label, None where nothing goes between the fingers.
        """
        candidates = shown.candidates
        fits = candidates.width_m <= shown.gripper.fingers_open_m
        if not fits.any():
            return Label(None, SOURCE)
        best = int(np.argmax(np.where(fits, self.liking(shown, rng), -np.inf)))
        return Label(int(candidates.label[best]), SOURCE)

    def liking(self, shown: Shown, rng: np.random.Generator) -> Floats:
        """How much it likes each candidate.

        Args:
            shown: the scene.
            rng: draws its errors and moods.

        Returns:
            (M,) float64, m.
        """
        candidates = shown.candidates
        hands = hand_distance.uprights(candidates.T_base_gripper, shown.gripper.half_m)
        clearance_m = hand_distance.to_points(hands, shown.points)[0]
        error_m = self.judgment_sigma_m * rng.standard_normal(len(clearance_m))
        clearance_m = np.minimum(clearance_m + error_m, self.enough_m)
        low = hands[:, 6] - shown.table_height_m < -self.into_table_m
        middle = (candidates.lines + 1) / 2
        off_center = np.abs(candidates.line - middle) / max(middle - 1.0, 1.0)
        habit = np.array(self.face_m)[candidates.face - 1] - self.off_center_m * off_center
        mood = self.mood_sigma_m * rng.standard_normal(len(clearance_m))
        return np.asarray(habit + mood + np.where(low, -self.enough_m, clearance_m))

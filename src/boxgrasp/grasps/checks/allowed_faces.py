"""Only the faces that the user allows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from boxgrasp.grasps.candidates import FACES
from boxgrasp.grasps.checks.check import Check, CheckResult
from boxgrasp.grasps.checks.context import CheckContext


@dataclass(frozen=True)
class AllowedFaces(Check):
    """The candidate is on one of the allowed faces.

    Attributes:
        faces: names of the allowed faces.
    """

    faces: tuple[str, ...]
    name = "allowed_faces"

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Yes on an allowed face."""
        allowed = np.array([face in self.faces for face in FACES])
        return CheckResult.yes_no(allowed[context.candidates.face - 1])

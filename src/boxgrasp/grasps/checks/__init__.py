"""The checks that every candidate must pass, the same for every ranker; a file a check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

from msgspec import Meta

from boxgrasp.errors import ConfigError
from boxgrasp.grasps.checks.allowed_faces import AllowedFaces
from boxgrasp.grasps.checks.approach_clearance import ApproachClearance
from boxgrasp.grasps.checks.check import (
    Check,
    CheckResult,
    Rejection,
    Witness,
    validate_check,
)
from boxgrasp.grasps.checks.context import CheckContext
from boxgrasp.grasps.checks.fingers_free import FingersFree
from boxgrasp.grasps.checks.holds import Holds
from boxgrasp.grasps.checks.occluded_clearance import OccludedClearance
from boxgrasp.grasps.checks.plane_clearance import PlaneClearance
from boxgrasp.grasps.checks.unseen_distance import UnseenDistance
from boxgrasp.grasps.checks.unseen_fraction import UnseenFraction
from boxgrasp.grasps.checks.visible_clearance import VisibleClearance
from boxgrasp.grasps.checks.width import Width
from boxgrasp.grasps.checks.width_known import WidthKnown
from boxgrasp.grasps.scoring import RED_BELOW_M
from boxgrasp.strict import plugin, plugin_names

PLUGINS = "boxgrasp.checks"

Clearance = Annotated[float, Meta(ge=0.0, le=0.5)]


@dataclass(frozen=True)
class ChecksConfig:
    """What a candidate must keep; section `checks` of the configuration.

    Attributes:
        visible_clearance_m: to visible obstacles, m (thesis section 3-4: feasible from 2 cm).
        noise_gain: standard deviations of what was measured that are asked beside
            visible_clearance_m and occluded_clearance_m, and between the target and the fingers.
            Measured on cast scenes: a gap seen as 2.0 cm is often less.
        occluded_clearance_m: to the hidden bodies under and behind visible surfaces, m.
        unseen_distance_m: to space that no ray crossed, m; 0 reports it and refuses nothing,
            since behind every thing there is a shadow.
        unseen_fraction: how much of the hand's box, grown by visible_clearance_m, may be unseen.
        pregrasp_distance_m: how far back the way in is checked, and the pregrasp lies, m.
        approach_clearance_m: along the way in to visible obstacles and hidden bodies, m.
        plane_clearance_m: of the hand's lowest corner over the support plane, m.
        held_area_m2: of the target's seen surface between the fingertips at least, m2. Measured on
            cast tables of uneven things: half of it lets rims and stray points through.
        finger_area_m2: of the target's seen surface where the fingers are at most, m2.
        plugins: further checks by the names of their entry points in the group
            `boxgrasp.checks`, each with its own settings (`{}` for none).
    """

    visible_clearance_m: Clearance = RED_BELOW_M
    noise_gain: Annotated[float, Meta(ge=0.0, le=20.0)] = 3.0
    occluded_clearance_m: Clearance = 0.02
    unseen_distance_m: Clearance = 0.0
    unseen_fraction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.25
    pregrasp_distance_m: Clearance = 0.15
    approach_clearance_m: Clearance = 0.005
    plane_clearance_m: Annotated[float, Meta(ge=-0.5, le=0.5)] = 0.003
    held_area_m2: Annotated[float, Meta(ge=0.0, le=0.01)] = 1.4e-4
    finger_area_m2: Annotated[float, Meta(ge=0.0, le=0.01)] = 3e-5
    plugins: dict[str, dict[str, Any]] = field(default_factory=dict)

    RENAMED: ClassVar[dict[str, str]] = {
        "clearance_m": "visible_clearance_m",
        "noise_m": "noise_gain",
        "noise_margin_m": "noise_gain",
        "body_m": "occluded_clearance_m",
        "unseen_m": "unseen_distance_m",
        "unseen_share": "unseen_fraction",
        "approach_back_m": "pregrasp_distance_m",
        "approach_m": "approach_clearance_m",
        "support_m": "plane_clearance_m",
        "width_m": "noise_gain",
        "width_margin_m": "noise_gain",
    }


def shipped_checks(config: ChecksConfig, faces: Sequence[str]) -> tuple[Check, ...]:
    """The checks that ship, in the order in which answers name them.

    Args:
        config: their limits.
        faces: names of the faces that are allowed.

    Returns:
        One check a line.
    """
    return (
        VisibleClearance(config.visible_clearance_m, config.noise_gain),
        OccludedClearance(config.occluded_clearance_m, config.noise_gain),
        UnseenDistance(config.unseen_distance_m),
        UnseenFraction(config.unseen_fraction, config.visible_clearance_m),
        ApproachClearance(config.approach_clearance_m, config.pregrasp_distance_m),
        PlaneClearance(config.plane_clearance_m),
        Width(config.noise_gain),
        WidthKnown(),
        Holds(config.held_area_m2),
        FingersFree(config.finger_area_m2),
        AllowedFaces(tuple(faces)),
    )


def plugin_checks(config: ChecksConfig) -> tuple[Check, ...]:
    """The checks that other packages bring, found by their entry points.

    Args:
        config: names and settings, `ChecksConfig.plugins`.

    Returns:
        One check a name, in the order of the configuration.

    Raises:
        ConfigError: no entry point has the name, it cannot be imported, does not take the
            settings, or is no check.
    """
    found = []
    for name, settings in config.plugins.items():
        check = plugin(PLUGINS, name, settings)
        if check is None:
            known = ", ".join(plugin_names(PLUGINS)) or "none is installed"
            raise ConfigError(
                f"checks.plugins: no entry point {name!r} in the group {PLUGINS}; valid: {known}"
            )
        found.append(validate_check(check))
    return tuple(found)


__all__ = [
    "Check",
    "CheckContext",
    "CheckResult",
    "ChecksConfig",
    "Rejection",
    "Witness",
    "plugin_checks",
    "shipped_checks",
]

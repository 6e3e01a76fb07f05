"""What a check is, what it answers, and the reasons that follow from its answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.geometry.hand_distance import CAP_M

if TYPE_CHECKING:
    from boxgrasp.grasps.checks.context import CheckContext

NO_OBJECT = -1
CAPPED = f"at least {100 * CAP_M:g} cm"


class Check(Protocol):
    """One condition that a grasp must meet, evaluated for all candidates at once.

    A class with a name and `evaluate` is a check; it need not inherit from this one.

    Attributes:
        name: lower case words joined by underscores; unique among the checks of a selector.
        map_resolutions_m: cell sizes, m, of the local maps that it needs beside the default one.
    """

    name: str
    map_resolutions_m: tuple[float, ...] = ()

    def evaluate(self, context: CheckContext) -> CheckResult:
        """Measure every candidate.

        Args:
            context: the candidates of one view, and all that is known round them.

        Returns:
            A value, a limit and whether it passed, for each of the M candidates.
        """


@dataclass(frozen=True, eq=False)
class CheckResult:
    """What one check says of M candidates; `at_least`, `at_most` and `yes_no` make one.

    Attributes:
        value: (M,) float64, finite.
        limit: (M,) float64, what the value was compared with.
        passed: (M,) bool.
        unit: of value and limit: "m", "m2", "fraction", or None for yes (1) or no (0).
        objects: (M,) int64, number of the object that decided, 0 for an obstacle without a
            number, -1 for none.
        nearest_points_m: (M, 3) float64, base frame, m, where it decided; NaN for nowhere.
    """

    value: Floats
    limit: Floats
    passed: NDArray[np.bool_]
    unit: str | None
    objects: NDArray[np.int64]
    nearest_points_m: Floats

    @staticmethod
    def at_least(
        value: ArrayLike, limit: float | Floats, witness: Witness | None = None, *, unit: str = "m"
    ) -> CheckResult:
        """The result of a check that passes where the value is `limit` or more.

        Args:
            value: (M,) in `unit`.
            limit: in `unit`, one for all or (M,).
            witness: what decided, where something did.
            unit: "m", "m2" or "fraction".

        Returns:
            The result.
        """
        values = np.asarray(value, dtype=np.float64)
        return _result(values, limit, values >= limit, witness, unit)

    @staticmethod
    def at_most(
        value: ArrayLike, limit: float | Floats, witness: Witness | None = None, *, unit: str = "m"
    ) -> CheckResult:
        """The result of a check that passes where the value is `limit` or less.

        Args:
            value: (M,) in `unit`.
            limit: in `unit`, one for all or (M,).
            witness: what decided, where something did.
            unit: "m", "m2" or "fraction".

        Returns:
            The result.
        """
        values = np.asarray(value, dtype=np.float64)
        return _result(values, limit, values <= limit, witness, unit)

    @staticmethod
    def yes_no(passed: ArrayLike) -> CheckResult:
        """The result of a check that knows yes and no alone.

        Args:
            passed: (M,) bool.

        Returns:
            The result, its value 1 for yes and 0 for no, its limit 1.
        """
        yes = np.asarray(passed, dtype=np.bool_)
        return _result(yes.astype(np.float64), 1.0, yes, None, None)

    @property
    def violation(self) -> Floats:
        """(M,) how far the value is off, as a share of the limit; 0 where it passed."""
        scale = np.where(self.limit == 0.0, 1.0, np.abs(self.limit))
        lack = np.abs(self.value - self.limit) / scale
        lack = np.where(self.limit == 0.0, 1.0, lack)  # no share of nothing: all of it lacks
        return np.where(self.passed, 0.0, lack)


@dataclass(frozen=True, eq=False)
class Witness:
    """What decided a check.

    Attributes:
        objects: (M,) int64, as in `CheckResult`.
        points_m: (M, 3) float64, base frame, m; NaN for nowhere.
    """

    objects: NDArray[np.int64]
    points_m: Floats


def _result(
    value: Floats,
    limit: float | Floats,
    passed: NDArray[np.bool_],
    witness: Witness | None,
    unit: str | None,
) -> CheckResult:
    count = len(value)
    if witness is None:
        witness = Witness(np.full(count, NO_OBJECT), np.full((count, 3), np.nan))
    return CheckResult(
        value=readonly(value.copy()),
        limit=readonly(np.full(count, limit, dtype=np.float64)),
        passed=readonly(np.asarray(passed)),
        unit=unit,
        objects=readonly(witness.objects),
        nearest_points_m=readonly(witness.points_m),
    )


@dataclass(frozen=True)
class Rejection:
    """Why a candidate was refused: one check that it failed.

    Attributes:
        check: the check's name.
        value: what was measured, in `unit`.
        limit: what was asked, in `unit`.
        unit: "m", "m2", "fraction", or None for yes (1) or no (0).
        object: number of the object that decided, 0 for an obstacle without a number; or None.
        nearest_point_m: base frame, m, where it decided; or None.
    """

    check: str
    value: float
    limit: float
    unit: str | None
    object: int | None = None
    nearest_point_m: tuple[float, float, float] | None = None

    @property
    def sentence(self) -> str:
        """The reason in words; nothing else words it."""
        what = self.check.replace("_", " ")
        if self.unit is None:
            return f"{what}: no"
        if self.object is not None:
            what += f" to object {self.object}" if self.object > 0 else " to an unnumbered obstacle"
        asked = "needs" if self.value < self.limit else "at most"
        values = (self.value, self.limit)
        finer = (
            digits
            for digits in (1, 2, 3)
            if len({spelled(v, self.unit, digits) for v in values}) > 1
        )
        digits = next(finer, 1)  # a value just off its limit must not read like it
        found, limit = (spelled(value, self.unit, digits) for value in values)
        if self.unit == "m" and self.value == CAP_M:
            found = CAPPED
        return f"{what}: {found}, {asked} {limit}"


def spelled(value: float, unit: str | None, digits: int = 1) -> str:
    """A check's value for people.

    Args:
        value: in `unit`.
        unit: as in `CheckResult`.
        digits: decimals of centimeters; one less of percent.

    Returns:
        `1.2 cm`, `43 %`, `yes`, or the number and its unit.
    """
    if unit is None:
        return "yes" if value else "no"
    if unit == "m":
        return f"{100 * value:.{digits}f} cm"
    if unit == "m2":
        return f"{1e4 * value:.{digits}f} cm2"
    return f"{100 * value:.{digits - 1}f} %" if unit == "fraction" else f"{value:g} {unit}"


def measured(value: float, unit: str | None) -> str:
    """What a check measured, for people; distances end at a cap.

    Args:
        value: in `unit`.
        unit: as in `CheckResult`.

    Returns:
        `4.2 cm`; `at least 50 cm` where the distance is the cap.
    """
    return CAPPED if unit == "m" and value == CAP_M else spelled(value, unit)


def validate_check(check: Any) -> Check:
    """A check, refused where it is none.

    Args:
        check: what a caller or a package handed over.

    Returns:
        The same check.

    Raises:
        ConfigError: it is a class, or has no name or no `evaluate`.
    """
    kind = check.__name__ if isinstance(check, type) else type(check).__name__
    if isinstance(check, type):
        raise ConfigError(f"check {kind} is a class; valid: an object of it, {kind}(...)")
    if not isinstance(getattr(check, "name", None), str) or not hasattr(check, "evaluate"):
        raise ConfigError(f"{kind} is no check; valid: an object with a name and evaluate(context)")
    found: Check = check
    return found


def validate_result(check: Check, result: CheckResult, count: int) -> CheckResult:
    """The result of a check, refused where it does not fit.

    Args:
        check: whose result it is.
        result: what it answered.
        count: number of candidates, M.

    Returns:
        The same result.

    Raises:
        BoxgraspError: it is no CheckResult, or an array of another shape or with NaN.
    """
    if not isinstance(result, CheckResult):
        raise BoxgraspError(
            f"check {check.name} answered {type(result).__name__}; valid: a CheckResult"
        )
    shapes = {"value": (count,), "limit": (count,), "passed": (count,), "objects": (count,)}
    for name, shape in {**shapes, "nearest_points_m": (count, 3)}.items():
        found = np.shape(getattr(result, name))
        if found != shape:
            raise BoxgraspError(f"check {check.name}: {name} has shape {found}; valid: {shape}")
    for name in ("value", "limit"):
        if not np.isfinite(getattr(result, name)).all():
            raise BoxgraspError(f"check {check.name}: {name} is not finite; valid: finite numbers")
    return result

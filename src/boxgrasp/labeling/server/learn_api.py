"""What the page asks of learning: begin, how far it is, and which models propose."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from boxgrasp.errors import ConfigError
from boxgrasp.labeling.learning import Learned, Learner
from boxgrasp.labeling.server.desk import Desk
from boxgrasp.labeling.server.sessions import Sessions


class _Of(BaseModel):
    model_config = ConfigDict(extra="forbid")

    session: str = Field(max_length=64)


class _Model(_Of):
    number: int | None = None


def learn_router(sessions: Sessions) -> APIRouter:
    """The routes of learning.

    Args:
        sessions: who may ask.

    Returns:
        To be included in the app.
    """
    router = APIRouter(prefix="/api", include_in_schema=False)
    desk = sessions.desk

    @router.get("/learning")
    def learning() -> dict[str, Any]:
        return _told(desk, _learner(desk))

    @router.post("/learn")
    def learn(words: _Of) -> dict[str, Any]:
        sessions.get(words.session)
        _learner(desk).start()
        return _told(desk, _learner(desk))

    @router.post("/learn/stop")
    def stop(words: _Of) -> dict[str, Any]:
        sessions.get(words.session)
        _learner(desk).cancel()
        return _told(desk, _learner(desk))

    @router.post("/model")
    def model(words: _Model) -> dict[str, Any]:
        sessions.get(words.session)
        desk.propose_with(words.number)
        return _told(desk, _learner(desk))

    return router


def _learner(desk: Desk) -> Learner:
    if desk.learner is None:
        raise ConfigError("nothing is learned here; valid: a page that `boxgrasp label` serves")
    return desk.learner


def _told(desk: Desk, learner: Learner) -> dict[str, Any]:
    """All that the page shows of learning, as JSON has it."""
    status, models = learner.status(), learner.models()
    latest = status.results or (models[-1] if models else None)
    return {
        "state": status.state,
        "fraction": status.fraction,
        "message": status.message,
        "latest": None if latest is None else _latest(latest),
        "models": [
            {"number": None, "name": f"{desk.configured}, as configured", "usable": True},
            *(
                {
                    "number": item.number,
                    "name": f"{item.number}: {item.labels} labels, {item.best or 'none usable'}",
                    "usable": item.best is not None,
                }
                for item in models
            ),
        ],
        "active": learner.active,
    }


def _latest(learned: Learned) -> dict[str, Any]:
    return {
        "labels": learned.labels,
        "mixed": learned.mixed,
        "nones": learned.nones,
        "commonest": learned.commonest,
        "notes": list(learned.notes),
        "versions": [
            {
                "name": item.version,
                "agreement": item.agreement,
                "spread": item.spread,
                "balanced": item.balanced,
                "why": item.why,
                "curve": [
                    {"labels": labels, "mean": mean, "spread": spread}
                    for labels, mean, spread in zip(
                        item.sizes, item.means, item.spreads, strict=True
                    )
                ],
            }
            for item in learned.versions
        ],
    }

"""What the page asks of learning: begin, how far, which model proposes."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, ConfigDict, Field

from boxgrasp.errors import BoxgraspError
from boxgrasp.labeling.learning import Learner
from boxgrasp.labeling.server.desk import Desk
from boxgrasp.labeling.server.sessions import Sessions


class _Of(BaseModel):
    model_config = ConfigDict(extra="forbid")

    session: str = Field(max_length=64)


class _Model(_Of):
    id: str = Field(max_length=64)

"""What /openapi.json says of bodies and answers; the published schema of an answer is part of it.

There is no /docs: the pages that FastAPI has for it load their scripts from another site.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from fastapi import FastAPI

from boxgrasp.result import JSON_SCHEMA_PATH
from boxgrasp.version import __version__

_COMPONENT: Final = "#/components/schemas/"
_TEXTS: Final = {
    "pixel": ("u,v on the target: column and row", "320,240"),
    "object": ("number of the target, as `boxgrasp objects` counts", "1"),
    "point": ("x,y,z on the target, base frame, meters", "0.6,0.0,0.8"),
    "box": ("u0,v0,u1,v1, pixels round the target, as an object detector gives them", "9,9,90,90"),
    "ranker": ("what orders the candidates; default: the server's", "clearance"),
    "faces": ("only these faces may be chosen, with commas between them", "front,right"),
    "checked": ("false takes the ranker's first candidate, whatever the checks say", "true"),
}
_ERRORS: Final = {
    400: "the request cannot be read",
    401: "the token is missing or wrong",
    403: "the request comes from another site's page",
    404: "no such ask is known",
    408: "the body took too long to come",
    409: "the ask's id is taken by another capture",
    413: "too large",
    415: "the body is of another type",
    422: "no answer is possible: no table, or no object where the target was pointed at",
    503: "too many captures are in hand",
}


def _text(name: str) -> dict[str, Any]:
    description, example = _TEXTS[name]
    return {"type": "string", "description": description, "examples": [example]}


def _file(description: str) -> dict[str, Any]:
    return {"type": "string", "format": "binary", "description": description}


_PARTS: Final[dict[str, Any]] = {
    "capture": _file("an .npz with the arrays depth, intrinsics, T_base_camera, ..."),
    "depth": _file("16-bit gray PNG, with `intrinsics`, in place of `capture`"),
    "intrinsics": {
        "type": "string",
        "description": "JSON: an object of fx, fy, cx, cy, width, height, or 3 rows of 3; pixels",
    },
    "depth_scale": {"type": "string", "description": "meters a unit of depth; default 0.001"},
    "T_base_camera": {
        "type": "string",
        "description": "JSON: 4 rows of 4, or position and quaternion of the camera, meters",
    },
    "color": _file("PNG or JPEG of the size of the depth"),
    "mask": _file("PNG of the size of the depth, not black on the target"),
    "robot_mask": _file("PNG of the size of the depth, not black on the robot's own arm"),
}


def upload(more: Mapping[str, tuple[str, str]] | None = None) -> dict[str, Any]:
    """Parameters and body of a request that brings a capture.

    Args:
        more: description and example of further parameters, by their names.

    Returns:
        What `openapi_extra` of a route takes.
    """
    texts = {name: _text(name) for name in _TEXTS}
    for name, (description, example) in (more or {}).items():
        texts[name] = {"type": "string", "description": description, "examples": [example]}
    parameters = [
        {
            "name": name,
            "in": "query",
            "required": False,
            "description": schema["description"],
            "schema": {"type": "string", "examples": schema["examples"]},
        }
        for name, schema in texts.items()
    ]
    form = {
        "type": "object",
        "additionalProperties": False,
        "properties": {**_PARTS, **texts},
        "oneOf": [{"required": ["capture"]}, {"required": ["depth", "intrinsics"]}],
    }
    content = {
        "application/octet-stream": {"schema": _PARTS["capture"]},
        "multipart/form-data": {"schema": form},
    }
    return {
        "parameters": parameters,
        "requestBody": {
            "required": True,
            "description": "A capture, and what is wanted of it; parameters stand in the form or "
            "in the query.",
            "content": content,
        },
    }


UPLOAD: Final = upload()


def answers(
    status: int | None, errors: Sequence[int], schema: str = "Selection"
) -> dict[int | str, Any]:
    """The answers of a route.

    Args:
        status: of a good one; None for one without a body.
        errors: statuses of the others; what the layer before the app answers is added.
        schema: component that a good answer has.

    Returns:
        What `responses` of a route takes.
    """
    said = {"Selection": "The answer, schema 2", "Asked": "The ask is in the queue"}
    found: dict[int | str, Any] = {}
    if status is not None:
        found[status] = _answer(said[schema], schema)
    for code in sorted({401, 403, *errors}):
        found[code] = _answer(_ERRORS[code], "Error")
    return found


def _answer(description: str, schema: str) -> dict[str, Any]:
    content = {"application/json": {"schema": {"$ref": _COMPONENT + schema}}}
    return {"description": description, "content": content}


def publish_schemas(app: FastAPI) -> None:
    """Make /openapi.json hold the schemas that the routes name.

    Args:
        app: with its routes, or before them.
    """
    before: Callable[[], dict[str, Any]] = app.openapi

    def openapi() -> dict[str, Any]:
        document = before()
        components = document.setdefault("components", {})
        components.setdefault("schemas", {}).update(_schemas())
        components["securitySchemes"] = {
            "token": {
                "type": "http",
                "scheme": "bearer",
                "description": "where the server was started with a token",
            }
        }
        document["security"] = [{}, {"token": []}]
        document["info"]["version"] = __version__
        return document

    app.openapi = openapi  # type: ignore[method-assign]


def _schemas() -> dict[str, Any]:
    """The published schema with its parts as components, and our own small ones."""
    published = json.loads(JSON_SCHEMA_PATH.read_text("utf-8"))
    parts = published.pop("$defs")
    published.pop("$schema")
    found = {"Selection": published}
    found |= {f"Selection_{name}": part for name, part in parts.items()}
    text = json.dumps(found).replace('"#/$defs/', f'"{_COMPONENT}Selection_')
    schemas: dict[str, Any] = json.loads(text)
    line = {"type": "string", "description": "what was found and what is valid, in one line"}
    schemas["Error"] = {
        "type": "object",
        "required": ["error"],
        "properties": {"error": line},
    }
    schemas["Asked"] = {
        "type": "object",
        "required": ["id", "seconds_left"],
        "properties": {
            "id": {"type": "string", "format": "uuid", "description": "of the ask"},
            "seconds_left": {"type": "number", "minimum": 0},
            "selection": {
                "$ref": f"{_COMPONENT}Selection",
                "description": "the robot's own answer, where the ask was put",
            },
        },
    }
    return schemas

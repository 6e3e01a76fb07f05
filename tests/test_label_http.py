from __future__ import annotations

import asyncio
import io
import json
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from helpers import answer_text, drawn, halved, seen
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from boxgrasp import Capture, GraspSelector, Selection, Target
from boxgrasp.io.npz import save_npz
from boxgrasp.result import JSON_SCHEMA_PATH

pytest.importorskip("fastapi", reason="needs boxgrasp[label]")
import httpx
import jsonschema
from fastapi import FastAPI

from boxgrasp.labeling.server.openapi import publish_schemas
from boxgrasp.labeling.server.security import Access, Guard, UploadLimits
from boxgrasp.labeling.server.select_api import Selections, select_router

SEEN = halved(seen(drawn(3), 3))
FILE = "capture.npz"


def png(image: np.ndarray) -> bytes:
    held = io.BytesIO()
    Image.fromarray(image).save(held, "PNG")
    return held.getvalue()


def npz(capture: Capture) -> bytes:
    held = io.BytesIO()
    save_npz(capture, held)
    return held.getvalue()


NPZ = npz(SEEN)
SELECTIONS = Selections(limits=UploadLimits(body_bytes=4 << 20, unpacked_bytes=8 << 20))


def app() -> Any:
    made = FastAPI(docs_url=None, redoc_url=None)
    made.include_router(select_router(SELECTIONS))
    publish_schemas(made)
    return Guard(made, Access("127.0.0.1", None, True), SELECTIONS.limits)


APP = app()


def asked(path: str, method: str = "POST", **request: Any) -> httpx.Response:
    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(APP)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            return await client.request(method, path, **request)

    return asyncio.run(ask())


def octets(data: bytes, query: str = "") -> httpx.Response:
    kind = {"content-type": "application/octet-stream"}
    return asked(f"/select{query}", content=data, headers=kind)


def depth_files(**more: Any) -> dict[str, Any]:
    assert SEEN.depth is not None
    raw = np.round(np.asarray(SEEN.depth) * 1000).astype(np.uint16)
    return {"depth": ("depth.png", png(raw), "image/png"), **more}


def depth_fields(**more: str) -> dict[str, str]:
    assert SEEN.intrinsics is not None and SEEN.T_base_camera is not None
    return {
        "intrinsics": json.dumps(SEEN.intrinsics.tolist()),
        "T_base_camera": json.dumps(SEEN.T_base_camera.tolist()),
        **more,
    }


def error_of(response: httpx.Response, status: int) -> str:
    assert response.status_code == status, response.text
    found = response.json()
    assert set(found) == {"error"} and "\n" not in found["error"]
    return str(found["error"])


def test_an_npz_gets_the_answer_that_python_gets() -> None:
    response = octets(NPZ)
    assert response.status_code == 200
    jsonschema.validate(response.json(), json.loads(JSON_SCHEMA_PATH.read_text()))
    direct = GraspSelector().select(SEEN)
    assert answer_text(Selection.from_json(response.text)) == answer_text(direct)


def test_a_depth_image_with_its_camera_gets_the_same_answer_as_its_capture() -> None:
    assert SEEN.depth is not None and SEEN.rgb is not None
    mask = GraspSelector().segment(SEEN) == 1
    files = depth_files(color=png(SEEN.rgb), mask=png(mask.astype(np.uint8) * 255))
    response = asked("/select", files=files, data=depth_fields())
    assert response.status_code == 200, response.text
    depth = (np.round(np.asarray(SEEN.depth) * 1000).astype(np.uint16) * 0.001).astype(np.float32)
    capture = Capture(depth, SEEN.intrinsics, SEEN.T_base_camera, SEEN.rgb, mask)
    direct = GraspSelector().select(capture)
    assert answer_text(Selection.from_json(response.text)) == answer_text(direct)


@pytest.mark.parametrize("where", ["query", "form"])
def test_settings_are_those_of_the_command_line(where: str) -> None:
    told = {"object": "1", "faces": "top-parallel, front", "ranker": "top-down", "checked": "false"}
    files = {"capture": (FILE, NPZ)}
    sent = {"params": told} if where == "query" else {"data": told}
    response = asked("/select", files=files, **sent)
    assert response.status_code == 200, response.text
    config = {"candidates": {"faces": ["top-parallel", "front"]}, "ranker": "top-down"}
    direct = GraspSelector({**config, "unchecked": True}).select(SEEN, Target(object=1))
    assert answer_text(Selection.from_json(response.text)) == answer_text(direct)


def test_selectors_are_kept_but_not_without_bound() -> None:
    held = Selections()
    from boxgrasp.labeling.server.uploads import Settings

    first = held.selector(Settings())
    assert held.selector(Settings()) is first
    faces = ("left", "front", "right", "top-parallel", "top-perpendicular")
    for face in faces:
        held.selector(Settings(faces=(face,)))
        held.selector(Settings(faces=(face,), checked=False))
    assert len(held._prepared) == 8
    assert held.selector(Settings()) is not first


REFUSED: list[tuple[str, Callable[[], httpx.Response], int, str]] = [
    ("no archive", lambda: octets(b"nothing"), 400, "capture: "),
    ("empty", lambda: octets(b""), 400, "capture: "),
    ("type", lambda: asked("/select", json={}), 415, "application/octet-stream"),
    ("no type", lambda: asked("/select", content=b"x"), 415, "Content-Type is missing; valid"),
    ("pixel", lambda: octets(NPZ, "?pixel=1"), 400, "pixel is '1'; valid: u,v"),
    ("float pixel", lambda: octets(NPZ, "?pixel=1,2.5"), 400, "whole pixels"),
    ("infinite", lambda: octets(NPZ, "?point=1,2,inf"), 400, "meters"),
    ("digits", lambda: octets(NPZ, "?object=" + 5000 * "9"), 400, "object is"),
    ("two", lambda: octets(NPZ, "?object=1&pixel=3,4"), 400, "pixel and object"),
    ("twice", lambda: octets(NPZ, "?object=1&object=1"), 400, "given twice"),
    ("name", lambda: octets(NPZ, "?objekt=1"), 400, "unknown name 'objekt'"),
    ("number", lambda: octets(NPZ, "?object=99"), 422, "no object 99; valid: 1 to"),
    ("outside", lambda: octets(NPZ, "?pixel=99999,1"), 422, "valid"),
    ("ranker", lambda: octets(NPZ, "?ranker=nobody"), 400, "unknown ranker: nobody; valid"),
    ("faces", lambda: octets(NPZ, "?faces=back"), 400, "valid"),
    ("checked", lambda: octets(NPZ, "?checked=maybe"), 400, "valid: true, false"),
    ("large", lambda: octets(bytes((4 << 20) + 1)), 413, "valid: at most 4194304 bytes"),
    (
        "no depth",
        lambda: asked("/select", files={"mask": b""}, data=depth_fields()),
        400,
        "depth is missing",
    ),
    ("no camera", lambda: asked("/select", files=depth_files()), 400, "intrinsics is missing"),
    (
        "both",
        lambda: asked("/select", files={"capture": (FILE, NPZ)}, data={"intrinsics": "1"}),
        400,
        "capture and intrinsics are given",
    ),
    (
        "camera's rows",
        lambda: asked("/select", files=depth_files(), data={"intrinsics": "[[1, 2], 3]"}),
        400,
        "3 rows of 3",
    ),
    (
        "millimeters",
        lambda: asked(
            "/select",
            files=depth_files(),
            data=depth_fields(T_base_camera="[0, 0, 1400, 0, 0, 0, 1]"),
        ),
        400,
        "millimeters",
    ),
    (
        "8 bit",
        lambda: asked(
            "/select",
            files={"depth": png(np.zeros((4, 4), np.uint8))},
            data={"intrinsics": "[[9, 0, 2], [0, 9, 2], [0, 0, 1]]"},
        ),
        400,
        "16 bit",
    ),
    (
        "parts",
        lambda: asked("/select", files=[("mask", ("m", b"1"))] * 25),
        413,
        "at most 24 files",
    ),
    (
        "long field",
        lambda: asked("/select", files=depth_files(), data={"intrinsics": "1" * 70000}),
        413,
        "fields of 65536 bytes",
    ),
]


@pytest.mark.parametrize(
    "call,status,said", [row[1:] for row in REFUSED], ids=[r[0] for r in REFUSED]
)
def test_a_request_that_gets_no_answer_gets_one_line(
    call: Callable[[], httpx.Response], status: int, said: str
) -> None:
    assert said in error_of(call(), status)


def test_a_small_archive_of_large_arrays_is_refused_before_it_is_unpacked() -> None:
    held = io.BytesIO()
    np.savez_compressed(held, depth=np.zeros((1100, 1000)), intrinsics=np.eye(3))
    assert "unpacks to" in error_of(octets(held.getvalue()), 400)


def test_a_picture_of_too_many_pixels_is_refused_before_it_is_unpacked() -> None:
    files = {"depth": png(np.zeros((4097, 4096), np.uint16))}
    line = error_of(asked("/select", files=files, data={"intrinsics": "{}"}), 413)
    assert "4096 x 4097 pixels; valid: at most 16777216" in line


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.binary(max_size=300), st.sampled_from(["application/octet-stream", "multipart/form-data"])
)
def test_bytes_of_any_kind_get_one_line(data: bytes, kind: str) -> None:
    response = asked("/select", content=data, headers={"content-type": f"{kind}; boundary=x"})
    assert "\n" not in error_of(response, 400)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.dictionaries(
        st.sampled_from(["intrinsics", "T_base_camera", "depth_scale", "pixel", "point", "faces"]),
        st.text(max_size=40)
        | st.recursive(
            st.none() | st.booleans() | st.floats() | st.integers(),
            lambda inner: st.lists(inner, max_size=4),
            max_leaves=8,
        ).map(json.dumps),
    )
)
def test_fields_of_any_text_get_one_line(fields: dict[str, str]) -> None:
    small = png(np.full((4, 4), 900, np.uint16))
    response = asked("/select", files={"depth": small}, data=fields)
    assert response.status_code in (400, 422), response.text
    error_of(response, response.status_code)


def test_selections_leave_the_event_loop_free_and_are_bounded() -> None:
    async def busy() -> tuple[list[int], int]:
        transport = httpx.ASGITransport(APP)
        kind = {"content-type": "application/octet-stream"}
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:

            def ask() -> Coroutine[Any, Any, httpx.Response]:
                return client.post("/select", content=NPZ, headers=kind, timeout=60)

            waiting = [asyncio.create_task(ask()) for _ in range(12)]
            ticks = 0
            while not all(task.done() for task in waiting):
                await asyncio.sleep(0.002)
                ticks += 1
            return sorted(task.result().status_code for task in waiting), ticks

    statuses, ticks = asyncio.run(busy())
    assert statuses == [200] * 8 + [503] * 4
    assert ticks > 5


def refs(found: Any) -> list[str]:
    if isinstance(found, dict):
        own = [found["$ref"]] if isinstance(found.get("$ref"), str) else []
        return own + [ref for value in found.values() for ref in refs(value)]
    return [ref for value in found for ref in refs(value)] if isinstance(found, list) else []


def test_the_openapi_document_holds_the_published_schema() -> None:
    document = asked("/openapi.json", "GET").json()
    assert document["openapi"].startswith("3.1")
    for ref in refs(document):
        place: Any = document
        for name in ref.removeprefix("#/").split("/"):
            place = place[name]
    route = document["paths"]["/select"]["post"]
    assert set(route["requestBody"]["content"]) == {
        "application/octet-stream",
        "multipart/form-data",
    }
    assert {item["name"] for item in route["parameters"]} >= {"pixel", "object", "ranker"}
    assert set(route["responses"]) >= {"200", "400", "401", "413", "415", "422", "503"}
    schema = {"$ref": "#/components/schemas/Selection", "components": document["components"]}
    answer = json.loads(octets(NPZ).text)
    jsonschema.Draft202012Validator(schema).validate(answer)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.Draft202012Validator(schema).validate({**answer, "grasp": {"label": 0}})


def test_no_page_loads_from_elsewhere() -> None:
    assert asked("/docs", "GET").status_code == 404
    assert asked("/redoc", "GET").status_code == 404

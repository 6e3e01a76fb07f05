"""One operator at the page: which scene is shown, what is said of it, and what comes next."""

from __future__ import annotations

import itertools
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

from boxgrasp.arrays import Floats
from boxgrasp.errors import BoxgraspError
from boxgrasp.grasps.candidates import FACES, line_name
from boxgrasp.labeling.server.desk import Desk, Unshowable, now
from boxgrasp.labeling.server.prepared import PreparedScene, told
from boxgrasp.labeling.server.view import OperatorView
from boxgrasp.labeling.words import Ask, OperatorLabel, Origin, Turn, Verdict, overridden
from boxgrasp.result import Candidate
from boxgrasp.strict import plain
from boxgrasp.version import __version__

LONGEST_NOTE: Final = 2000  # characters
LONGEST_NAME: Final = 60
Listener = Callable[[str], None]
_SAID: Final = ("verdict", "label", "note", "pixel")  # what of a label is the operator's answer
# Numbers of what is shown: no two alike, not even of a server that was started again.
_serials = itertools.count(time.time_ns() // 1_000_000)


class StaleError(BoxgraspError):
    """What the page says is of a scene that is not shown any more."""


@dataclass(frozen=True)
class Said:
    """What the page says of the scene that it shows.

    Attributes:
        label_id: the UUID that came with the scene, so that saying it twice is kept once.
        scene_key: of that scene.
        verdict: `candidate`, `none` or `box_wrong`.
        label: of the candidate.
        note: the operator's own words.
        pixel: of the right thing, where the box is wrong.
    """

    label_id: str
    scene_key: str
    verdict: Verdict
    label: int | None = None
    note: str = ""
    pixel: tuple[int, int] | None = None


@dataclass(frozen=True, eq=False)
class Shown:
    """A scene that is shown.

    Attributes:
        prepared: all that is shown of it.
        turn: whose it is.
        label_id: of the label that will be said of it.
        since: when it was shown, s of the monotonic clock.
        origin: what the label will be of.
        standing: the operator's own label, which is corrected; None for a new one.
        ask: the robot's question; None where it asked none.
    """

    prepared: PreparedScene
    turn: Turn
    label_id: str
    since: float
    origin: Origin
    standing: OperatorLabel | None = None
    ask: Ask | None = None


class Session:
    """One operator at the page; safe from several threads.

    Args:
        desk: what all operators share.
        operator: the name.
    """

    def __init__(self, desk: Desk, operator: str) -> None:
        self.id = uuid.uuid4().hex
        self.operator = operator
        self._desk = desk
        self._lock = threading.RLock()
        self._listeners: list[Listener] = []
        self._serial = next(_serials)
        self._shown: Shown | None = None
        self._aside: Shown | None = None  # the turn that waits while an earlier label is corrected
        self._skipped: set[str] = set()
        self._passed_asks: set[str] = set()
        self._notice = ""
        self._revealed = False
        self._choice: tuple[int | None, int | None] = (None, None)
        self._picked: tuple[int, int] | None = None
        own = desk.record.standing(desk.source, operator)
        self._saved = [item.id for item in own]
        self._trail = list(dict.fromkeys(item.scene_key for item in own))
        self._ahead: Future[Turn | None] | None = None
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="ahead")
        self.view = OperatorView(self._line_clicked, self._point_clicked)
        self._advance()

    def close(self) -> None:
        """Give the scenes back and stop the view."""
        with self._lock:
            self._pool.shutdown(wait=True)
            try:
                for turn in self._held():
                    self._desk.record.release(turn.scene.key, self.operator)
            except BoxgraspError:
                pass  # they are given to others when their time is over
            self.view.close()

    def _held(self) -> list[Turn]:
        """The scenes that nobody else is given: shown, put aside, and next."""
        held = [item.turn for item in (self._shown, self._aside) if item is not None]
        if self._ahead is not None and self._ahead.done() and self._ahead.exception() is None:
            ahead = self._ahead.result()
            held += [] if ahead is None else [ahead]
        return held

    def listen(self, listener: Listener) -> Callable[[], None]:
        """Be told when something changes that the page did not ask for.

        Args:
            listener: called with `state` or `choice`, from any thread.

        Returns:
            Ends it.
        """
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def tell(self, what: str) -> None:
        """Tell everybody who listens.

        Args:
            what: as `listen`.
        """
        for listener in tuple(self._listeners):
            listener(what)

    def keep(self) -> None:
        """Say that the operator is still there, so that nobody else is given the scene."""
        with self._lock:
            for turn in self._held():
                self._desk.record.renew(turn.scene.key, self.operator, now())

    # What the operator says.

    def save(self, said: Said) -> None:
        """Keep a label, then show the next scene; the label is in the record before this returns.

        Where the next scene cannot be shown, this one stays with a notice; what is said of it then
        corrects the label, and the same again adds no row.

        Args:
            said: what the page says.

        Raises:
            StaleError: it is of a scene that is not shown any more.
            BoxgraspError: no such candidate, or the record cannot be written.
        """
        with self._lock:
            shown, row = self._shown, self._kept(said)
            if row is not None and (shown is None or said.label_id != shown.label_id):
                return  # the page never got the answer
            if shown is None or said.scene_key != shown.turn.scene.key:
                raise StaleError("that scene is not shown any more; valid: the one shown")
            if row is None:
                row = self._label_of(said, shown)
                if shown.standing is not None and _says_the_same(row, shown.standing):
                    row = shown.standing
                else:
                    self._desk.record.save(row)
                    self._saved.append(row.id)
            if said.scene_key not in self._trail:
                self._trail.append(said.scene_key)
            self._notice = ""
            try:
                self._go_on()
            except BoxgraspError as error:
                self._notice = f"Saved. The next scene cannot be shown: {error}. Enter tries again."
                self._shown = replace(shown, standing=row, label_id=str(uuid.uuid4()))

    def _kept(self, said: Said) -> OperatorLabel | None:
        """The label, where it is in the record already."""
        row = self._desk.record.find(said.label_id)
        own = row is not None and (row.scene_key, row.operator) == (said.scene_key, self.operator)
        return row if own else None

    def _label_of(self, said: Said, shown: Shown) -> OperatorLabel:
        selection, scene = shown.prepared.selection, shown.turn.scene
        failed: tuple[dict[str, Any], ...] = ()
        if said.verdict == "candidate":
            if said.label is None:
                raise BoxgraspError("no candidate chosen; valid: a face and a line")
            failed = overridden(selection.candidate(said.label))
        return OperatorLabel(
            id=said.label_id,
            scene_key=scene.key,
            operator=self.operator,
            verdict=said.verdict,
            label=said.label if said.verdict == "candidate" else None,
            labeled_at=now(),
            seconds=round(time.monotonic() - shown.since, 3),
            gripper=plain(selection.gripper),
            box_kind=scene.box_kind,
            lines=scene.lines,
            version=__version__,
            model=self._desk.model,
            proposed=None if selection.grasp is None else selection.grasp.label,
            overridden=failed,
            note=said.note.strip()[:LONGEST_NOTE],
            pixel=said.pixel if said.verdict == "box_wrong" else None,
            origin=shown.origin,
            supersedes=self._superseded(shown),
        )

    def _superseded(self, shown: Shown) -> str | None:
        """Id of the operator's own label that the new one corrects."""
        if shown.standing is not None:
            return shown.standing.id
        if shown.turn.again:
            return None
        mine = self._standing(shown.turn.scene.key)
        return None if mine is None else mine.id

    def _standing(self, key: str) -> OperatorLabel | None:
        """The operator's own last label of a scene that stands."""
        rows = self._desk.record.standing(operator=self.operator, scene_key=key)
        return rows[-1] if rows else None

    def _go_on(self) -> None:
        """After a label: return to the turn that waits, or take the next one."""
        if self._aside is not None:
            aside, self._aside = self._aside, None
            self._show(replace(aside, since=time.monotonic()))
        else:
            self._advance()

    def skip(self) -> None:
        """Leave the scene to others, and show the next one."""
        with self._lock:
            if self._shown is None:
                return
            if self._shown.ask is not None:
                self._passed_asks.add(self._shown.ask.id)
            elif self._aside is None:
                self._skipped.add(self._shown.turn.scene.key)
            if self._shown.ask is not None or self._aside is None:
                self._desk.record.release(self._shown.turn.scene.key, self.operator)
            self._notice = ""
            self._go_on()

    def return_to_skipped(self) -> None:
        """Take the scenes again that were skipped."""
        with self._lock:
            self._skipped.clear()
            if self._shown is None:
                self._advance()
                self.tell("state")

    def undo(self) -> None:
        """Take the last label back, and show its scene again.

        An undone correction restores what it corrected. Nothing is deleted: both are new rows.

        Raises:
            BoxgraspError: the record cannot be written.
        """
        with self._lock:
            record = self._desk.record
            while self._saved:
                last = record.find(self._saved.pop())
                if last is None:
                    continue
                before = self._before(last)
                if before is None:
                    record.withdraw(last.id, self.operator, str(uuid.uuid4()), now())
                    record.hold(last.scene_key, self.operator, self._desk.rules.turns, now())
                    self._trail = [key for key in self._trail if key != last.scene_key]
                else:
                    again = replace(
                        before, id=str(uuid.uuid4()), labeled_at=now(), supersedes=last.id
                    )
                    record.save(again)
                    self._saved.append(again.id)
                self._put_aside()
                self._notice = "The last label is taken back."
                self._show_scene(last.scene_key)
                return
            self._notice = "There is no label to take back."

    def _before(self, label: OperatorLabel) -> OperatorLabel | None:
        """What a correction corrected."""
        if label.supersedes is None:
            return None
        before = self._desk.record.find(label.supersedes)
        return None if before is None or before.verdict == "withdrawn" else before

    def back(self, step: int) -> None:
        """Go through one's own labels.

        Args:
            step: -1 to the one before, 1 to the next.
        """
        with self._lock:
            at = len(self._trail)
            if self._shown is not None and self._shown.turn.scene.key in self._trail:
                at = self._trail.index(self._shown.turn.scene.key)
            to = at + step
            if 0 <= to < len(self._trail):
                self._put_aside()
                self._show_scene(self._trail[to])
            elif to >= len(self._trail) and at < len(self._trail):
                self._go_on()

    def jump(self, number: int) -> None:
        """Show a scene by its number in the source.

        Args:
            number: from 1.

        Raises:
            BoxgraspError: no such scene, or it is with another operator.
        """
        with self._lock:
            scenes = self._desk.scenes
            if not 1 <= number <= len(scenes):
                raise BoxgraspError(f"no scene {number}; valid: 1 to {len(scenes)}")
            key = scenes[number - 1].key
            if self._shown is not None and self._shown.turn.scene.key == key:
                return
            if not self._desk.record.hold(key, self.operator, self._desk.rules.turns, now()):
                raise BoxgraspError(f"scene {number} is with another operator; valid: another one")
            self._put_aside()
            self._show_scene(key)

    def waiting_asks(self) -> int:
        """How many questions of the robot wait; an operator who has nothing to do is shown one.

        Returns:
            Their number.
        """
        waiting = self._desk.record.open_asks(now())
        if self._shown is None and any(ask.id not in self._passed_asks for ask in waiting):
            self.answer_ask()
            self.tell("state")
        return len(waiting)

    def answer_ask(self) -> None:
        """Show the oldest question of the robot that nobody has, a skipped one too."""
        with self._lock:
            self._passed_asks.clear()
            shown = self._next_ask()
            if shown is not None:
                self._put_aside()
                self._show(shown)

    def _put_aside(self) -> None:
        """Keep the turn that is shown for later, where it is one that has no label yet."""
        shown = self._shown
        if shown is None or shown.standing is not None or shown.turn.scene.key in self._trail:
            return
        if self._aside is None:
            self._aside = shown
        elif self._aside.turn.scene.key != shown.turn.scene.key:  # one that was jumped to
            self._desk.record.release(shown.turn.scene.key, self.operator)

    # What is shown.

    def _advance(self) -> None:
        """Show the robot's question, or the next scene that can be shown."""
        asked = self._next_ask()
        if asked is not None:
            self._show(asked)
            return
        while True:
            turn = self._taken_turn()
            if turn is None:
                self._shown = None
                self._serial = next(_serials)
                self.view.clear()
                return
            found = self._desk.prepared(turn.scene).result()
            if isinstance(found, PreparedScene):
                self._show(self._new(found, turn))
                return
            self._unshowable(found)

    def _unshowable(self, found: Unshowable) -> None:
        self._notice = f"{found.scene.name} cannot be shown: {found.reason}"
        self._skipped.add(found.scene.key)
        self._desk.record.release(found.scene.key, self.operator)

    def _taken_turn(self) -> Turn | None:
        ahead, self._ahead = self._ahead, None
        turn = None
        with suppress(BoxgraspError):  # what failed then is asked anew
            turn = None if ahead is None else ahead.result()
        if turn is not None and turn.scene.key not in self._skipped:
            # Who looked for longer than a scene is kept may have lost the next one to others.
            if self._desk.record.renew(turn.scene.key, self.operator, now()):
                return turn
        return self._desk.next_turn(self.operator, self._skipped)

    def _new(self, prepared: PreparedScene, turn: Turn) -> Shown:
        origin: Origin = "assist" if self._desk.rules.mode == "assist" else "page"
        return Shown(prepared, turn, str(uuid.uuid4()), time.monotonic(), origin)

    def _show_scene(self, key: str) -> None:
        """Show one scene, whether it has a label of this operator or not."""
        scene = self._desk.record.scene(key)
        found = self._desk.prepared(scene).result()
        if isinstance(found, Unshowable):
            self._unshowable(found)
            self._go_on()
            return
        self._show(replace(self._new(found, Turn(scene)), standing=self._standing(key)))

    def _next_ask(self) -> Shown | None:
        record = self._desk.record
        for ask in record.open_asks(now()):
            if ask.id in self._passed_asks:
                continue
            if not record.hold(ask.scene_key, self.operator, self._desk.rules.turns, now()):
                continue
            scene = record.scene(ask.scene_key)
            found = self._desk.prepared(scene).result()
            if isinstance(found, PreparedScene):
                return replace(self._new(found, Turn(scene)), origin="ask", ask=ask)
            self._notice = f"{scene.name} cannot be shown: {found.reason}"
        return None

    def _show(self, shown: Shown) -> None:
        self._shown = shown
        self._serial = next(_serials)
        self._revealed = shown.origin in ("assist", "ask")
        self._picked = None
        self.view.show(shown.prepared)
        self._choice = (None, None)
        proposed = self._proposed(shown)
        if proposed is not None:
            self.choose(proposed.face, proposed.label)
        elif self._revealed:
            self.view.choose(None, None, revealed=True)
        if self._ahead is None and self._aside is None and shown.ask is None:
            skip = {*self._skipped, shown.turn.scene.key}
            self._ahead = self._pool.submit(self._look_ahead, skip)

    def _look_ahead(self, skip: set[str]) -> Turn | None:
        """The turn after this one, its scene being made ready."""
        turn = self._desk.next_turn(self.operator, skip)
        if turn is not None:
            self._desk.prepared(turn.scene)
        return turn

    def _proposed(self, shown: Shown) -> Candidate | None:
        """The robot's own choice, where it is to propose one and found one."""
        selection = shown.prepared.selection
        if shown.origin != "assist" or selection.grasp is None or shown.standing is not None:
            return None
        return selection.candidate(selection.grasp.label)

    # What is clicked.

    def choose_in(self, serial: int, face: int | None, label: int | None) -> None:
        """The same, of the scene that the page shows; too late, it means nothing.

        Args:
            serial: of what the page shows.
            face: as `choose`.
            label: as `choose`.
        """
        with self._lock:
            if serial == self._serial:
                self.choose(face, label)

    def choose(self, face: int | None, label: int | None) -> None:
        """Show a face's lines, or the hand at a candidate.

        Args:
            face: 1 to 5, None for none.
            label: of a candidate of that face, None for none.
        """
        with self._lock:
            if self._shown is None:
                return
            count = len(self._shown.prepared.selection.candidates)
            face = face if face in range(1, len(FACES) + 1) else None
            label = label if label in range(1, count + 1) else None
            self._choice = (face, label)
            self.view.choose(face, label, revealed=self._revealed)

    def reveal(self, *, on: bool) -> None:
        """Whether candidates show what the robot thinks of them.

        Args:
            on: whether they do.
        """
        with self._lock:
            self._revealed = on
            self.choose(*self._choice)

    def pick(self, *, on: bool) -> None:
        """Whether a click in the cloud means the right thing, where the box is wrong.

        Args:
            on: whether it does.
        """
        with self._lock:
            self.view.pick_points(on=on)
            if not on:
                self._picked = None
                self.view.mark(None)

    def _line_clicked(self, label: int) -> None:
        with self._lock:
            if self._shown is None:
                return
            lines = self._shown.turn.scene.lines
            self.choose((label - 1) // lines + 1, label)
        self.tell("choice")

    def _point_clicked(self, point_m: Floats) -> None:
        with self._lock:
            if self._shown is None:
                return
            self._picked = self._shown.prepared.pixel_of(point_m)
            self.view.mark(point_m)
        self.tell("choice")

    # What the page reads.

    @property
    def image(self) -> bytes | None:
        """The camera's view of the scene that is shown, JPEG."""
        shown = self._shown
        return None if shown is None else shown.prepared.image

    def choice(self) -> dict[str, Any]:
        """What is chosen in the view.

        Returns:
            Plain values.
        """
        with self._lock:
            face, label = self._choice
            return {"serial": self._serial, "face": face, "label": label, "pixel": self._picked}

    def state(self) -> dict[str, Any]:
        """All that the page shows beside the view.

        Returns:
            Plain values, as JSON has them.
        """
        with self._lock:
            desk = self._desk
            progress = desk.record.progress(desk.source, self.operator, now())
            return {
                "session": self.id,
                "operator": self.operator,
                "mode": desk.rules.mode,
                "source": desk.source,
                "model": desk.model,
                "serial": self._serial,
                "notice": self._notice,
                "skipped": len(self._skipped),
                "asks": len(desk.record.open_asks(now())),
                "progress": plain(progress),
                "labels": len(self._saved),
                "choice": self.choice(),
                "shown": None if self._shown is None else self._shown_state(self._shown),
            }

    def _shown_state(self, shown: Shown) -> dict[str, Any]:
        scene, prepared, standing = shown.turn.scene, shown.prepared, shown.standing
        height_px, width_px = prepared.capture.shape or (None, None)
        own, ask = None, None
        if standing is not None:
            own = {name: getattr(standing, name) for name in _SAID}
        if shown.ask is not None:
            left_s = (shown.ask.expires_at - now()).total_seconds()
            ask = {"asker": shown.ask.asker, "seconds_left": left_s}
        return {
            "label_id": shown.label_id,
            "scene_key": scene.key,
            "name": scene.name,
            "number": self._desk.number_of(scene.key),
            "origin": shown.origin,
            "again": shown.turn.again,
            "second": shown.turn.second,
            "lines": scene.lines,
            "line_names": [
                [line_name(face, line, scene.lines) for line in range(1, scene.lines + 1)]
                for face in range(1, len(FACES) + 1)
            ],
            "width_px": width_px,
            "height_px": height_px,
            "standing": own,
            "ask": ask,
            "proposal": self._proposal(shown),
            "told": [told(item) for item in prepared.selection.candidates]
            if self._revealed
            else None,
        }

    def _proposal(self, shown: Shown) -> dict[str, Any] | None:
        """What the robot says, where it is to speak."""
        selection = shown.prepared.selection
        if shown.origin not in ("assist", "ask"):
            return None
        return {
            "status": selection.status,
            "label": None if selection.grasp is None else selection.grasp.label,
            "headline": selection.headline(),
            "warnings": [item.message for item in selection.warnings],
            "ranker": selection.ranker,
        }


def _says_the_same(one: OperatorLabel, other: OperatorLabel) -> bool:
    names = (*_SAID, "gripper", "box_kind", "lines")
    return all(getattr(one, name) == getattr(other, name) for name in names)

"""The record of labels: a database in which no label is ever changed or deleted."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from datetime import datetime
from os import PathLike
from types import TracebackType

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError

from boxgrasp.errors import LabelError, StoreError
from boxgrasp.labeling.record import agreement, labels, turns
from boxgrasp.labeling.record.checks import check_ask, check_id, check_label, check_scene
from boxgrasp.labeling.record.connection import Database, is_taken
from boxgrasp.labeling.record.labels import KeptLabel
from boxgrasp.labeling.record.tables import (
    ASK_FIELDS,
    ASKS,
    BATCH,
    LABELS,
    SCENES,
    SOURCES,
    ask_of,
    insert_all,
    scene_of,
    scene_row,
)
from boxgrasp.labeling.words import (
    Agreement,
    Ask,
    LabelScene,
    OperatorLabel,
    Progress,
    Turn,
    TurnRules,
)

_ROUNDS = 50  # how often the list of free scenes is made anew where others take all of it
_OF_CONTENT = ("kind", "box_kind", "lines", "capture_sha256", "target", "row_config", "number")


class Record:
    """Scenes, what operators said of them, who has which before them, and what robots ask.

    Use `Record.open`. Threads may share one; so may processes share the database.

    Attributes:
        name: the database's URL as it may be printed.
    """

    name: str

    def __init__(self, database: Database) -> None:
        self._database = database
        self.name = database.name

    @staticmethod
    def open(url: str | PathLike[str], create: bool = True) -> Record:
        """Open a database of labels, and bring its schema up to date.

        Args:
            url: a path, `sqlite:///PATH` or `postgresql+pg8000://USER@HOST/DATABASE`, the password
                in it or in the environment's `PGPASSWORD`.
            create: whether to make it where nothing is.

        Returns:
            The record.

        Raises:
            ConfigError: no such URL.
            StoreError: it cannot be reached, is something else, or a newer boxgrasp made it.
        """
        return Record(Database(url, create))

    def close(self) -> None:
        """Let go of every connection."""
        self._database.close()

    def __enter__(self) -> Record:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # Scenes.

    def add_scenes(self, source: str, scenes: Sequence[LabelScene]) -> None:
        """Add scenes to a source, behind those that it has; one that it has stays where it is.

        Args:
            source: a set, a folder of captures.
            scenes: in the order in which they are to be labeled.

        Raises:
            LabelError: one is no scene, or another one than what is known by its key.
            StoreError: the database cannot be written.
        """
        for scene in scenes:
            check_scene(scene)
        wanted = {scene.key: scene for scene in scenes}
        with self._database.reads() as connection:
            known = {scene.key: scene for scene in _scenes(connection, source)}
        _check_same(wanted, known)
        if wanted.keys() <= known.keys():
            return
        with self._database.writes() as connection:
            _put_scenes(connection, wanted)
            _place(connection, source, {key: scene.name for key, scene in wanted.items()})

    def scene(self, key: str) -> LabelScene:
        """A scene.

        Args:
            key: of the scene.

        Returns:
            The scene, with the name that it was first added by.

        Raises:
            LabelError: no such one.
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            query = sa.select(SCENES).where(SCENES.c.key == key)
            row = connection.execute(query).mappings().first()
        if row is None:
            raise LabelError(f"no scene {key[:120]} is known; valid: one that was added")
        return scene_of(row)

    def scenes(self, source: str | None = None) -> list[LabelScene]:
        """The scenes of a source, or all.

        Args:
            source: its name; None for all scenes.

        Returns:
            In the source's order; all by their keys.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            return _scenes(connection, source)

    # Turns.

    def next_turn(
        self,
        source: str,
        operator: str,
        rules: TurnRules,
        now: datetime,
        skip: Collection[str] = (),
    ) -> Turn | None:
        """The scene that an operator is to label now, which is then nobody else's.

        What the operator has already comes back first, so that a page that was loaded again shows
        the same. To prepare the scene after it, ask with its key in `skip`: an operator may have
        several.

        Args:
            source: whose scenes.
            operator: who asks.
            rules: which scenes come twice.
            now: when.
            skip: keys of scenes that are passed over.

        Returns:
            The turn, None where nothing is left for this operator now.

        Raises:
            StoreError: the database cannot be written.
        """
        wish = turns.Wish(source, operator, rules, now, frozenset(skip))
        for _ in range(_ROUNDS):
            with self._database.reads() as connection:
                keys = turns.candidates(connection, wish)
            if not keys:
                return None
            for key in keys:
                with self._database.writes() as connection:
                    turn = turns.take(connection, key, wish)
                if turn is not None:
                    return turn
        return None

    def hold(self, scene_key: str, operator: str, rules: TurnRules, now: datetime) -> bool:
        """Let an operator have one scene, whatever labels it has.

        Args:
            scene_key: of the scene.
            operator: who wants it.
            rules: for how long.
            now: when.

        Returns:
            Whether it is this operator's now; False where somebody else has it.

        Raises:
            LabelError: no such scene.
            StoreError: the database cannot be written.
        """
        self.scene(scene_key)
        with self._database.writes() as connection:
            return turns.hold(connection, scene_key, turns.Wish("", operator, rules, now))

    def renew(self, scene_key: str, operator: str, now: datetime) -> bool:
        """Let an operator keep a scene for longer.

        Args:
            scene_key: of the scene.
            operator: who has it.
            now: when.

        Returns:
            Whether it is still this operator's.

        Raises:
            StoreError: the database cannot be written.
        """
        with self._database.writes() as connection:
            return turns.renew(connection, scene_key, operator, now)

    def release(self, scene_key: str, operator: str) -> None:
        """Let others have a scene.

        Args:
            scene_key: of the scene.
            operator: who has it; a scene of somebody else stays theirs.

        Raises:
            StoreError: the database cannot be written.
        """
        with self._database.writes() as connection:
            turns.release(connection, scene_key, operator)

    # Labels.

    def save(self, label: OperatorLabel) -> OperatorLabel:
        """Keep a label; it is on the disk when this returns. Saving the same again keeps it once.

        Two are the same if they have one id and differ in `labeled_at`, `seconds` and `version`
        at most, which a server notes anew at every try.

        Args:
            label: with an id of its own.

        Returns:
            What is kept under its id: the first that was saved.

        Raises:
            LabelError: no label, another one of the same id, or a correction of what is corrected
                already, is another operator's, or is not there.
            StoreError: the database cannot be written.
        """
        check_label(label)
        try:
            with self._database.writes() as connection:
                return labels.add(connection, label)
        except IntegrityError:  # another writer came in between; what it wrote is seen now
            pass
        try:
            with self._database.writes() as connection:
                return labels.add(connection, label)
        except IntegrityError as error:
            if label.supersedes is not None and is_taken(error, "supersedes"):
                raise labels.superseded(label.supersedes) from None
            raise StoreError(f"{self.name}: label {label.id} is refused; valid: a label") from None

    def withdraw(self, id: str, operator: str, new_id: str, now: datetime) -> OperatorLabel:
        """Take a label back, by a row that supersedes it.

        Args:
            id: of the label.
            operator: whose it is.
            new_id: of the row.
            now: when.

        Returns:
            The row.

        Raises:
            LabelError: no such label of this operator, or it is superseded already.
            StoreError: the database cannot be written.
        """
        check_id(new_id)
        with self._database.reads() as connection:
            old = labels.label_with(connection, id)
        if old is None or old.operator != operator:
            raise LabelError(f"no label {id[:36]} of {operator} is known; valid: one's own label")
        return self.save(labels.withdrawal(old, new_id, now))

    def standing(
        self,
        source: str | None = None,
        operator: str | None = None,
        scene_key: str | None = None,
    ) -> list[OperatorLabel]:
        """Labels that are neither superseded nor withdrawn.

        A scene has several where two operators labeled it, or one did twice.

        Args:
            source: only of its scenes.
            operator: only these.
            scene_key: only of this scene.

        Returns:
            The oldest first.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            return labels.standing(connection, source, operator, scene_key)

    def find(self, id: str) -> OperatorLabel | None:
        """A label by its id, whether it stands or not.

        Args:
            id: of the label.

        Returns:
            The label; None where there is none.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            return labels.label_with(connection, id)

    def history(self, scene_key: str) -> list[OperatorLabel]:
        """Every row of a scene, superseded and withdrawn ones too.

        Args:
            scene_key: of the scene.

        Returns:
            The oldest first.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            return labels.history(connection, scene_key)

    def kept(self) -> list[KeptLabel]:
        """Every row with its scene, as `take_in` takes it.

        Returns:
            The oldest first.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            scenes = {scene.key: scene for scene in _scenes(connection, None)}
            placed = connection.execute(
                sa.select(SOURCES.c.scene_key, SOURCES.c.source, SOURCES.c.name).order_by(
                    SOURCES.c.source
                )
            )
            sources: dict[str, dict[str, str]] = {key: {} for key in scenes}
            for key, source, name in placed:
                sources[key][source] = name
            rows = labels.history(connection)
        return [KeptLabel(row, scenes[row.scene_key], sources[row.scene_key]) for row in rows]

    def take_in(self, kept: Sequence[KeptLabel]) -> int:
        """Add labels of another record with their scenes; all of them or none.

        Args:
            kept: in any order; what is there already is not added again.

        Returns:
            How many were new.

        Raises:
            LabelError: one contradicts what is there.
            StoreError: the database cannot be written.
        """
        scenes: dict[str, LabelScene] = {}
        sources: dict[str, dict[str, str]] = {}
        for item in kept:
            check_scene(item.scene)
            check_label(item.label)
            _check_same({item.scene.key: item.scene}, scenes)
            scenes.setdefault(item.scene.key, item.scene)
            for source, name in item.sources.items():
                sources.setdefault(source, {})[item.scene.key] = name
        try:
            with self._database.writes() as connection:
                _put_scenes(connection, scenes)
                for source, names in sources.items():
                    _place(connection, source, names)
                return labels.take_in(connection, [item.label for item in kept])
        except IntegrityError:
            raise StoreError(
                f"{self.name}: another one added a label meanwhile; valid: to try again"
            ) from None

    def progress(self, source: str, operator: str, now: datetime) -> Progress:
        """How far one operator, and all of them, are.

        Args:
            source: whose scenes.
            operator: whose labels.
            now: up to when.

        Returns:
            Counts, and the rate of the operator's last labels, pauses of ten minutes left out.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            return labels.progress(connection, source, operator, now)

    def agreements(self, source: str | None = None) -> list[Agreement]:
        """How often operators say the same, each two of them and each with itself.

        Args:
            source: only of its scenes.

        Returns:
            By the operators' names.

        Raises:
            StoreError: the database cannot be read.
        """
        return agreement.agreements(self.standing(source))

    # What robots ask.

    def add_ask(self, ask: Ask) -> None:
        """Put a question into the queue; the same again is put once.

        Args:
            ask: of a scene that was added.

        Raises:
            LabelError: no ask, another one of the same id, or of no known scene.
            StoreError: the database cannot be written.
        """
        check_ask(ask)
        self.scene(ask.scene_key)
        row = {name: getattr(ask, name) for name in ASK_FIELDS} | {"withdrawn": False}
        with self._database.writes() as connection:
            insert_all(connection, ASKS, [row], skip_known=True)
            kept = connection.execute(sa.select(ASKS).where(ASKS.c.id == ask.id)).mappings().one()
        if ask_of(kept) != ask:
            raise LabelError(f"ask {ask.id} is kept already and differs; valid: an id of its own")

    def ask(self, id: str) -> Ask | None:
        """A question, whatever became of it.

        Args:
            id: of the ask.

        Returns:
            The ask; None where none has this id.

        Raises:
            StoreError: the database cannot be read.
        """
        with self._database.reads() as connection:
            query = sa.select(ASKS).where(ASKS.c.id == id)
            found = connection.execute(query).mappings().one_or_none()
            return None if found is None else ask_of(found)

    def open_asks(self, now: datetime) -> list[Ask]:
        """What robots still wait for.

        Args:
            now: when.

        Returns:
            The oldest first, without those that are answered, withdrawn or expired.

        Raises:
            StoreError: the database cannot be read.
        """
        answered = sa.exists().where(_answers(), ASKS.c.scene_key == LABELS.c.scene_key)
        query = sa.select(ASKS).where(
            ~ASKS.c.withdrawn, ASKS.c.expires_at > now, ~answered.correlate(ASKS)
        )
        with self._database.reads() as connection:
            rows = connection.execute(query.order_by(ASKS.c.asked_at, ASKS.c.id)).mappings()
            return [ask_of(row) for row in rows]

    def answer_of(self, ask_id: str) -> OperatorLabel | None:
        """What an operator answered.

        Args:
            ask_id: of the ask.

        Returns:
            The label, None while there is none.

        Raises:
            LabelError: no such ask.
            StoreError: the database cannot be read.
        """
        query = sa.select(LABELS.c.id).join(ASKS, ASKS.c.scene_key == LABELS.c.scene_key)
        query = query.where(ASKS.c.id == ask_id, _answers())
        with self._database.reads() as connection:
            self._known_ask(connection, ask_id)
            found = connection.scalar(query.order_by(LABELS.c.labeled_at).limit(1))
            return None if found is None else labels.label_with(connection, found)

    def withdraw_ask(self, id: str) -> None:
        """Take a question out of the queue.

        Args:
            id: of the ask.

        Raises:
            LabelError: no such ask.
            StoreError: the database cannot be written.
        """
        with self._database.writes() as connection:
            self._known_ask(connection, id)
            connection.execute(sa.update(ASKS).where(ASKS.c.id == id).values(withdrawn=True))

    def _known_ask(self, connection: sa.Connection, ask_id: str) -> None:
        if connection.scalar(sa.select(ASKS.c.id).where(ASKS.c.id == ask_id)) is None:
            raise LabelError(f"no ask {ask_id[:36]} is known; valid: one that was added")


def _answers() -> sa.ColumnElement[bool]:
    """Of a row of `labels` beside one of `asks` of the same scene: whether it answers."""
    later = LABELS.c.labeled_at >= ASKS.c.asked_at
    return sa.and_(LABELS.c.origin == "ask", later, turns.stands())


def _scenes(connection: sa.Connection, source: str | None) -> list[LabelScene]:
    if source is None:
        query = sa.select(SCENES).order_by(SCENES.c.key)
        return [scene_of(row) for row in connection.execute(query).mappings()]
    query = turns.scenes_of(source).order_by(SOURCES.c.position, SOURCES.c.scene_key)
    return [scene_of(row) for row in connection.execute(query).mappings()]


def _put_scenes(connection: sa.Connection, scenes: dict[str, LabelScene]) -> None:
    """Add checked scenes that are not there yet.

    Raises:
        LabelError: one is another one than what is known by its key.
    """
    # By key, so that two who add the same at once do not wait for each other in a circle.
    rows = [scene_row(scenes[key]) for key in sorted(scenes)]
    insert_all(connection, SCENES, rows, skip_known=True)
    for k in range(0, len(rows), BATCH):
        keys = [row["key"] for row in rows[k : k + BATCH]]
        found = connection.execute(sa.select(SCENES).where(SCENES.c.key.in_(keys))).mappings()
        _check_same(scenes, {row["key"]: scene_of(row) for row in found})


def _place(connection: sa.Connection, source: str, names: dict[str, str]) -> None:
    """Put scenes, which are called so there, behind those that a source has."""
    last = sa.select(sa.func.max(SOURCES.c.position)).where(SOURCES.c.source == source)
    highest = connection.scalar(last)
    first = 0 if highest is None else highest + 1
    rows = [
        {"source": source, "scene_key": key, "position": first + k, "name": name}
        for k, (key, name) in enumerate(names.items())
    ]
    rows.sort(key=lambda row: str(row["scene_key"]))
    insert_all(connection, SOURCES, rows, skip_known=True)


def _check_same(wanted: dict[str, LabelScene], known: dict[str, LabelScene]) -> None:
    """Refuse a scene that is another one than what is known by its key; names may differ."""
    for key in wanted.keys() & known.keys():
        for name in _OF_CONTENT:
            if getattr(wanted[key], name) != getattr(known[key], name):
                raise LabelError(
                    f"scene {key} is known with another {name}; valid: one key a scene"
                )

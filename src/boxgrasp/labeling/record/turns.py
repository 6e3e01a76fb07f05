"""Which scene an operator is given next, and whose it is meanwhile.

Two operators ask at the same time and take the same scene: the one whose row of `leases` comes
first has it, the other tries the next one. No lock is held while anybody looks.

Scenes that come twice are chosen by their keys alone, so that every server chooses the same ones.
They come among the new ones, not after them: an operator may never reach the end, and habits change
over hundreds of scenes. One comes again to its operator after `SPACING` other labels, so that it is
not remembered, and every other turn at most is such a one, so that new scenes go on.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from boxgrasp.labeling.record.tables import LABELS, LEASES, SCENES, SOURCES, scene_of
from boxgrasp.labeling.words import LabelScene, Turn, TurnRules

SPACING = 20  # labels between two of the same scene; a short memory for pictures holds fewer
_AT_ONCE = 20  # scenes that are tried before the list is made anew
_LATER = LABELS.alias("later")


@dataclass(frozen=True)
class Wish:
    """An operator asks for a scene.

    Attributes:
        source: whose scenes.
        operator: who asks.
        rules: which scenes come twice.
        now: when.
        skip: keys of scenes that are passed over.
    """

    source: str
    operator: str
    rules: TurnRules
    now: datetime
    skip: Collection[str] = ()


def stands() -> sa.ColumnElement[bool]:
    """Of a row of `labels`: whether it is neither superseded nor withdrawn.

    Returns:
        The condition.
    """
    superseded = sa.exists().where(_LATER.c.supersedes == LABELS.c.id).correlate(LABELS)
    return sa.and_(LABELS.c.verdict != "withdrawn", ~superseded)


def scenes_of(source: str) -> sa.Select[Any]:
    """The rows of a source's scenes, each with the name that the source has for it.

    Args:
        source: its name.

    Returns:
        The query.
    """
    columns = [column for column in SCENES.c if column.name != "name"]
    joined = SCENES.join(SOURCES, SOURCES.c.scene_key == SCENES.c.key)
    query = sa.select(*columns, SOURCES.c.name).select_from(joined)
    return query.where(SOURCES.c.source == source)


def candidates(connection: sa.Connection, wish: Wish) -> list[str]:
    """Scenes of which an operator may be given one now.

    Args:
        connection: to the database.
        wish: who asks for what.

    Returns:
        Their keys, the first choice first; others may take some of them at the same moment.
    """
    steps = [_own_ones, _second_ones, _spaced_ones, _new_ones, _soon_ones]
    if _last_was_twice(connection, wish):
        steps = [_own_ones, _new_ones, _second_ones, _spaced_ones, _soon_ones]
    lists = (step(connection, wish) for step in steps)
    return next((keys for keys in lists if keys), [])


def take(connection: sa.Connection, key: str, wish: Wish) -> Turn | None:
    """Give an operator a scene, if it is still free and still to be labeled.

    Args:
        connection: of a transaction that writes.
        key: of the scene.
        wish: who asks for what.

    Returns:
        The turn; None where another operator has it, or it needs no label of this operator.
    """
    _claim(connection, key, wish)
    mine = sa.and_(LEASES.c.scene_key == key, LEASES.c.operator == wish.operator)
    if connection.scalar(sa.select(LEASES.c.scene_key).where(mine)) is None:
        return None
    # Looked at after the claim: who had the scene before may have labeled it in between.
    turn = _turn(connection, key, wish)
    if turn is None:
        connection.execute(sa.delete(LEASES).where(mine))
    return turn


def hold(connection: sa.Connection, key: str, wish: Wish) -> bool:
    """Give an operator a scene, whatever labels it has.

    Args:
        connection: of a transaction that writes.
        key: of the scene.
        wish: who asks.

    Returns:
        Whether it is this operator's now.
    """
    _claim(connection, key, wish)
    mine = sa.and_(LEASES.c.scene_key == key, LEASES.c.operator == wish.operator)
    return connection.scalar(sa.select(LEASES.c.scene_key).where(mine)) is not None


def renew(connection: sa.Connection, key: str, operator: str, now: datetime) -> bool:
    """Let an operator keep a scene for longer.

    Args:
        connection: of a transaction that writes.
        key: of the scene.
        operator: who has it.
        now: when.

    Returns:
        Whether it is still this operator's.
    """
    mine = sa.and_(LEASES.c.scene_key == key, LEASES.c.operator == operator)
    lease_s = connection.scalar(sa.select(LEASES.c.lease_s).where(mine))
    if lease_s is None:
        return False
    until = now + timedelta(seconds=lease_s)
    return connection.execute(sa.update(LEASES).where(mine).values(expires_at=until)).rowcount == 1


def release(connection: sa.Connection, key: str, operator: str) -> None:
    """Let others have a scene.

    Args:
        connection: of a transaction that writes.
        key: of the scene.
        operator: who has it; a scene of somebody else stays theirs.
    """
    mine = sa.and_(LEASES.c.scene_key == key, LEASES.c.operator == operator)
    connection.execute(sa.delete(LEASES).where(mine))


def _claim(connection: sa.Connection, key: str, wish: Wish) -> None:
    """One row a scene: the first wins, unless its time is over."""
    row = {
        "scene_key": key,
        "operator": wish.operator,
        "given_at": wish.now,
        "expires_at": wish.now + timedelta(seconds=wish.rules.lease_s),
        "lease_s": wish.rules.lease_s,
    }
    own = LEASES.c.operator == wish.operator
    changed = {**row, "given_at": sa.case((own, LEASES.c.given_at), else_=wish.now)}
    free = sa.or_(LEASES.c.expires_at <= wish.now, own)
    insert = sqlite.insert if connection.dialect.name == "sqlite" else postgresql.insert
    connection.execute(
        insert(LEASES)
        .values(row)
        .on_conflict_do_update(index_elements=["scene_key"], set_=changed, where=free)
    )


def _turn(connection: sa.Connection, key: str, wish: Wish) -> Turn | None:
    """The turn that a scene is for an operator by the labels that stand."""
    counted = sa.select(LABELS.c.operator, sa.func.count()).where(
        LABELS.c.scene_key == key, stands()
    )
    counts = {who: n for who, n in connection.execute(counted.group_by(LABELS.c.operator))}
    row = connection.execute(scenes_of(wish.source).where(SCENES.c.key == key)).mappings().one()
    own, others = counts.pop(wish.operator, 0), len(counts)
    again = own == 1 and row["again_draw"] < wish.rules.again_share
    second = own == 0 and others == 1 and row["second_draw"] < wish.rules.second_share
    if own + others and not again and not second:
        return None
    scene: LabelScene = scene_of(row)
    return Turn(scene, again=own > 0, second=others > 0)


def _listed(connection: sa.Connection, query: sa.Select[Any]) -> list[str]:
    return list(connection.scalars(query.limit(_AT_ONCE)))


def _free(key: sa.ColumnElement[str], wish: Wish) -> sa.ColumnElement[bool]:
    """Whether a scene is neither passed over nor with somebody else."""
    taken = sa.select(LEASES.c.scene_key).where(
        LEASES.c.operator != wish.operator, LEASES.c.expires_at > wish.now
    )
    return sa.and_(key.not_in(taken), key.not_in(sorted(wish.skip)))


def _own_ones(connection: sa.Connection, wish: Wish) -> list[str]:
    """What the operator has: after a reload, or a restart, the same comes back."""
    query = sa.select(LEASES.c.scene_key).where(
        LEASES.c.operator == wish.operator,
        LEASES.c.scene_key.not_in(sorted(wish.skip)),
        _in_source(LEASES.c.scene_key, wish),
    )
    return _listed(connection, query.order_by(LEASES.c.given_at, LEASES.c.scene_key))


def _new_ones(connection: sa.Connection, wish: Wish) -> list[str]:
    """Scenes without a label that stands, in the source's order."""
    # Not a condition on each scene: PostgreSQL would go through all labels for each.
    labeled = sa.select(LABELS.c.scene_key).where(stands())
    query = sa.select(SOURCES.c.scene_key).where(
        SOURCES.c.source == wish.source,
        SOURCES.c.scene_key.not_in(labeled),
        _free(SOURCES.c.scene_key, wish),
    )
    return _listed(connection, query.order_by(SOURCES.c.position, SOURCES.c.scene_key))


def _second_ones(connection: sa.Connection, wish: Wish) -> list[str]:
    """Scenes that one other operator labeled and that are to have two, the oldest label first."""
    if wish.rules.second_share <= 0.0:
        return []
    mine = sa.func.sum(sa.case((LABELS.c.operator == wish.operator, 1), else_=0))
    query = _labeled(wish, SCENES.c.second_draw < wish.rules.second_share)
    return _listed(
        connection, query.having(sa.func.count(LABELS.c.operator.distinct()) == 1, mine == 0)
    )


def _spaced_ones(connection: sa.Connection, wish: Wish) -> list[str]:
    """Scenes that come again, with enough others in between."""
    if wish.rules.again_share <= 0.0:
        return []
    before = connection.scalar(
        sa.select(LABELS.c.labeled_at)
        .where(LABELS.c.operator == wish.operator, LABELS.c.verdict != "withdrawn")
        .order_by(LABELS.c.labeled_at.desc())
        .offset(SPACING)
        .limit(1)
    )
    if before is None:
        return []
    return _listed(connection, _again(wish).having(sa.func.min(LABELS.c.labeled_at) <= before))


def _soon_ones(connection: sa.Connection, wish: Wish) -> list[str]:
    """Scenes that come again, when nothing else is left; the longest ago first."""
    return _listed(connection, _again(wish)) if wish.rules.again_share > 0.0 else []


def _again(wish: Wish) -> sa.Select[Any]:
    """Scenes that this operator labeled once and that are to come twice."""
    query = _labeled(wish, SCENES.c.again_draw < wish.rules.again_share)
    return query.where(LABELS.c.operator == wish.operator).having(sa.func.count() == 1)


def _labeled(wish: Wish, drawn: sa.ColumnElement[bool]) -> sa.Select[Any]:
    """Scenes of the source with labels that stand; few are drawn, and all else is asked of them."""
    key = LABELS.c.scene_key
    query = sa.select(key).where(
        key.in_(sa.select(SCENES.c.key).where(drawn)),
        stands(),
        _in_source(key, wish),
        _free(key, wish),
    )
    return query.group_by(key).order_by(sa.func.min(LABELS.c.labeled_at), key)


def _in_source(key: sa.ColumnElement[str], wish: Wish) -> sa.ColumnElement[bool]:
    found = sa.exists().where(SOURCES.c.source == wish.source, SOURCES.c.scene_key == key)
    return found.correlate_except(SOURCES)


def _last_was_twice(connection: sa.Connection, wish: Wish) -> bool:
    """Whether somebody had labeled the scene of the operator's last label before."""
    last = connection.execute(
        sa.select(LABELS.c.scene_key, LABELS.c.id)
        .where(LABELS.c.operator == wish.operator, stands())
        .order_by(LABELS.c.labeled_at.desc())
        .limit(1)
    ).first()
    if last is None:
        return False
    key, label_id = last
    others = sa.select(LABELS.c.id).where(
        LABELS.c.scene_key == key, LABELS.c.id != label_id, stands()
    )
    return connection.scalar(others.limit(1)) is not None

"""The first schema: scenes and their sources, labels, leases, asks."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

_JSON = sa.JSON(none_as_null=True)
_MOMENT = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Make the tables, and let the database refuse to change or delete a label."""
    _make_scenes()
    _make_labels()
    _make_queues()
    if op.get_bind().dialect.name == "sqlite":
        for what in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER labels_no_{what.lower()} BEFORE {what} ON labels "
                "BEGIN SELECT RAISE(ABORT, 'labels are only ever added'); END"
            )
        return
    op.execute(
        "CREATE FUNCTION labels_only_added() RETURNS trigger LANGUAGE plpgsql AS "
        "$$BEGIN RAISE EXCEPTION 'labels are only ever added'; END$$"
    )
    op.execute(
        "CREATE TRIGGER labels_only_added BEFORE UPDATE OR DELETE OR TRUNCATE ON labels "
        "FOR EACH STATEMENT EXECUTE FUNCTION labels_only_added()"
    )


def _make_scenes() -> None:
    op.create_table(
        "scenes",
        sa.Column("key", sa.String(120), primary_key=True),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("box_kind", sa.String(16), nullable=False),
        sa.Column("lines", sa.Integer, nullable=False),
        sa.Column("capture_sha256", sa.String(64)),
        sa.Column("target", _JSON),
        sa.Column("row_config", _JSON),
        sa.Column("number", sa.BigInteger),
        sa.Column("second_draw", sa.Double, nullable=False),
        sa.Column("again_draw", sa.Double, nullable=False),
    )
    op.create_index("scenes_drawn_for_second", "scenes", ["second_draw"])
    op.create_index("scenes_drawn_for_again", "scenes", ["again_draw"])
    op.create_table(
        "source_scenes",
        sa.Column("source", sa.Text, primary_key=True),
        sa.Column("scene_key", sa.String(120), sa.ForeignKey("scenes.key"), primary_key=True),
        sa.Column("position", sa.BigInteger, nullable=False),
        sa.Column("name", sa.Text, nullable=False),
    )
    op.create_index("source_scenes_in_order", "source_scenes", ["source", "position", "scene_key"])


def _make_labels() -> None:
    op.create_table(
        "labels",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("scene_key", sa.String(120), sa.ForeignKey("scenes.key"), nullable=False),
        sa.Column("operator", sa.Text, nullable=False),
        sa.Column("verdict", sa.String(16), nullable=False),
        sa.Column("label", sa.Integer),
        sa.Column("labeled_at", _MOMENT, nullable=False),
        sa.Column("seconds", sa.Double),
        sa.Column("gripper", _JSON, nullable=False),
        sa.Column("box_kind", sa.String(16), nullable=False),
        sa.Column("lines", sa.Integer, nullable=False),
        sa.Column("version", sa.Text, nullable=False),
        sa.Column("model", sa.Text, nullable=False),
        sa.Column("proposed", sa.Integer),
        sa.Column("overridden", _JSON, nullable=False),
        sa.Column("note", sa.Text, nullable=False),
        sa.Column("pixel", _JSON),
        sa.Column("origin", sa.String(16), nullable=False),
        sa.Column("pose", _JSON),
        sa.Column("pose_distance_m", sa.Double),
        sa.Column("pose_angle_rad", sa.Double),
        sa.Column("supersedes", sa.String(36), sa.ForeignKey("labels.id"), unique=True),
        sa.CheckConstraint(
            "(verdict = 'candidate') = (label IS NOT NULL)", name="labels_candidate_has_label"
        ),
        sa.CheckConstraint(
            "verdict <> 'withdrawn' OR supersedes IS NOT NULL", name="labels_withdrawn_supersedes"
        ),
    )
    op.create_index("labels_of_scene", "labels", ["scene_key", "operator"])
    op.create_index("labels_of_operator", "labels", ["operator", "labeled_at"])


def _make_queues() -> None:
    op.create_table(
        "leases",
        sa.Column("scene_key", sa.String(120), sa.ForeignKey("scenes.key"), primary_key=True),
        sa.Column("operator", sa.Text, nullable=False),
        sa.Column("given_at", _MOMENT, nullable=False),
        sa.Column("expires_at", _MOMENT, nullable=False),
        sa.Column("lease_s", sa.Double, nullable=False),
    )
    op.create_index("leases_of_operator", "leases", ["operator"])
    op.create_table(
        "asks",
        sa.Column("id", sa.String(36), primary_key=True),
        sa.Column("scene_key", sa.String(120), sa.ForeignKey("scenes.key"), nullable=False),
        sa.Column("asked_at", _MOMENT, nullable=False),
        sa.Column("expires_at", _MOMENT, nullable=False),
        sa.Column("asker", sa.Text, nullable=False),
        sa.Column("selection", sa.Text, nullable=False),
        sa.Column("withdrawn", sa.Boolean, nullable=False),
    )
    op.create_index("asks_of_scene", "asks", ["scene_key"])

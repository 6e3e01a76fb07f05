"""What is read into the thesis where it is silent or prints two things, and what is ours alone."""

from __future__ import annotations

from boxgrasp.ranking.sampling import RESOLUTION_M
from boxgrasp.study.answers.samplings import TABLE_M, table_in_lowest_cell
from boxgrasp.study.report import Row, Section, Table

_STEPS = 700  # table heights over one 7 cm cell, 0.1 mm apart

READINGS = (
    (
        "center of the half sphere",
        "in three ways",
        "over the middle of the box's base, 5 cm up",
        "the parameter that section 3-2 settles on",
    ),
    (
        "grid samples",
        "an algorithm that starts at the rim and gives 195 points",
        "odd multiples of half a cell from the center",
        "gives the 184 of the text, and 60 and 120 in the portions",
    ),
    (
        "spiral samples",
        "angles counted from 1",
        "from 0",
        "gives the 57 and 118 of table 3-2; from 1 they would be 58 and 116",
    ),
    (
        "portion before a side face",
        "y at most that of the center",
        "y below it",
        "the first sample of each of the spiral's four layers lies at y = 0: with them 61, the "
        "table says 57. Of the grid's none lies there",
    ),
    (
        "three lines a face",
        "l steps that equally divide it; figure 2-3",
        "at 1/6, 1/2 and 5/6 of its edge, the middles of three equal strips",
        "lines at the edges themselves would close on air",
    ),
    (
        "place of the map's cells",
        "not said; OctoMap's lattice is the world's",
        "aligned with the half sphere, turned with the box",
        "so that a sample is the middle of its cell wherever the target stands. The thesis's "
        "target always stood at the same place of the table, so that its samples met the "
        "lattice in one way too; ours does not. The table is no reason: its top at 0.80 m "
        "lies in the 7 cm cell from 0.77 to 0.84 m of the world's lattice, the lowest "
        "samples at 0.85 m in the next",
    ),
    (
        "a miss in the map",
        "not said; OctoMap's own is 0.4, and its map had run over many frames",
        "0.3, so that a cell crossed once counts as free",
        "one frame alone must do",
    ),
    (
        "the map of several runs",
        "one map, fed by every frame, never reset",
        "a map for each decision; beside it one that is never reset",
        "decisions stay independent. In the one that runs on, what noise once filled stays until "
        "it is crossed often enough, so that the runs of a scene lean on each other",
    ),
    (
        "samples on the map that runs on",
        "round the box, which is fitted anew to each frame",
        "they stay where the first frame's box was; the box's dimensions are each frame's",
        "the cells stay, as the thesis's did, and a sample stays the middle of its cell; a box "
        "that moves by millimeters would move the thesis's samples with it",
    ),
    (
        'dimensions over "the maximal edge"',
        "can be read in two ways",
        "the training set's longest edge; each box's own is reported beside it",
        "the other loses the scale",
    ),
    (
        '"high accuracy and larger gamma"',
        "no rule; the reason is the bias of unequal classes",
        "of the pairs within half a point of the best accuracy the best balanced one, then the "
        "larger gamma; never a pair that says one class always",
        "where nine in ten labels are of one class, the largest gamma says it always",
    ),
    (
        "several classes",
        "told as one against the rest",
        "one against one",
        "that is what LIBSVM does; the other is measured beside it",
    ),
)
LIBERTIES = (
    ("lamps", "a simple table lamp", "two of them, shades 13 and 18 cm wide and 10 and 12 cm high "
     "that hang on a rod, 20 to 30 cm over the table, as the text says"),
    ("mug, wooden bar, colors", "not given", "dimensions and colors are ours"),
    ("yaw of obstacles", "not said", "turned at random; the target stands along the base's axes"),
    ("jitter of the camera", "one robot, fully lifted, looking at the table", "its place varies by "
     "20 and 30 cm, its height by 25 cm, its gaze by 10 cm from scene to scene"),
    ("place of the target", "always the center of the table", "up to 2 cm off it along x and y"),
    ("number of obstacles", "a maximum of four", "1 to 4, each as likely; none is no clutter"),
    ("noise in simulation", "Gazebo's, not said", "none; an Xtion's as a variant"),
    ("the operator", "one person", "a rule with such habits, set to what the text keeps of them"),
    ("the robot and its table", "ten and 42 real scenes", "simulated scenes, strong sensor noise"),
)  # fmt: skip


def declared_section() -> Section:
    """Readings and liberties, and the lattice by arithmetic.

    Returns:
        The section.
    """
    return Section(
        key="declared",
        title="Declared: how the thesis is read, and what is ours",
        place="sections 2-1, 2-2, 3-1, 3-2, 3-3, 3-5-2; appendix B",
        words=(
            "Where the thesis is silent, prints two things, or prints what its own counts "
            "contradict, one reading was taken. What it does not say had to be made up.",
        ),
        rows=(*_lattice_rows(), _shared_row()),
        tables=(
            Table("Readings", ("what", "printed", "here", "why"), READINGS),
            Table("Liberties", ("what", "the thesis", "here"), LIBERTIES),
        ),
    )


def _lattice_rows() -> tuple[Row, ...]:
    """The cells of the table's top and of the lowest samples, on the world's lattice."""
    words = {True: "one cell", False: "two cells"}
    return tuple(
        Row(
            f"table's top at 0.80 m and lowest samples at 0.85 m, {name}",
            "not sampled",
            words[table_in_lowest_cell(RESOLUTION_M[name], TABLE_M)],
            f"{100 * RESOLUTION_M[name]:.0f} cm cells of the world's lattice",
        )
        for name in ("spiral", "grid")
    )


def _shared_row() -> Row:
    heights = [0.70 + 0.0001 * k for k in range(_STEPS)]
    shared = sum(table_in_lowest_cell(RESOLUTION_M["grid"], height) for height in heights)
    return Row(
        "table heights at which they would share a 7 cm cell",
        None,
        f"{shared / _STEPS:.2f} of all",
        "heights from 0.70 m to 0.77 m, 0.1 mm apart",
    )

"""How often operators say the same: the share, and Cohen's kappa."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterable, Sequence
from itertools import combinations_with_replacement

from boxgrasp.labeling.words import Agreement, OperatorLabel


def agreements(labels: Iterable[OperatorLabel]) -> list[Agreement]:
    """Of each two operators that labeled the same scenes, and of each with itself.

    Two operators are compared by their first labels of a scene, which neither of them knew; one
    with itself by the first and the second.

    Args:
        labels: that stand, the oldest first.

    Returns:
        By the operators' names; only of those that share a scene.
    """
    said: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for label in labels:
        said[label.operator][label.scene_key].append(answer_of(label))
    found = []
    for first, second in combinations_with_replacement(sorted(said), 2):
        ours, theirs = said[first], said[second]
        if first == second:
            pairs = [(answers[0], answers[1]) for answers in ours.values() if len(answers) > 1]
        else:
            pairs = [(ours[key][0], theirs[key][0]) for key in sorted(ours.keys() & theirs.keys())]
        if pairs:
            same = sum(a == b for a, b in pairs) / len(pairs)
            found.append(Agreement(first, second, len(pairs), same, cohens_kappa(pairs)))
    return found


def answer_of(label: OperatorLabel) -> str:
    """What a label says, as two of them are compared.

    Args:
        label: not a withdrawn one.

    Returns:
        Its candidate's number, or its verdict.
    """
    return str(label.label) if label.verdict == "candidate" else label.verdict


def cohens_kappa(pairs: Sequence[tuple[Hashable, Hashable]]) -> float | None:
    """Agreement beyond what the two would have by chance (Cohen 1960).

    Args:
        pairs: what each of the two said, one a scene; at least one.

    Returns:
        1 for always, 0 for as by chance; None where both always say the same one thing, since
        chance then agrees always.
    """
    n = len(pairs)
    ours, theirs = Counter(a for a, _ in pairs), Counter(b for _, b in pairs)
    by_chance = sum(count * theirs[answer] for answer, count in ours.items())  # of n * n
    if by_chance == n * n:
        return None
    same = sum(a == b for a, b in pairs)
    return (same * n - by_chance) / (n * n - by_chance)

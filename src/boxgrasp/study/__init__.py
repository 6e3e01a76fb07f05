"""The thesis's experiments again: its figures beside ours, with intervals, in one report."""

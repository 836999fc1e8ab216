"""The kinds of figures of a run."""

DISTRIBUTIONS = ("cdf", "box", "violin")
KINDS = (*DISTRIBUTIONS, "curve", "heatmap", "time", "pairs")
AXES = {"curve": 1, "heatmap": 2}  # kinds with swept parameters on their axes, and how many

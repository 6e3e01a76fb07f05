"""Transforms, planes, boxes, and the only distances of the package. A leaf: it knows no camera."""

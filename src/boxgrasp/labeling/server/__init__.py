"""The labeling page and the HTTP interface, one ASGI app."""

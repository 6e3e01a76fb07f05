"""The labelling page and the HTTP interface, one ASGI app."""

"""Which points over the support plane belong together."""

"""Compiled loops. Each stands beside the naive version that tests it."""

"""Rankers order the candidates, best first, and say how confident they are."""

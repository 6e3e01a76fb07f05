"""Operators label scenes; sets hold them; SVMs are trained on them."""

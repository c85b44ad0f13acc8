"""Curves of roads by hand: in fine steps along a curve, adding up what each step leads ahead and to the left."""

from __future__ import annotations

import numpy as np

from carla_recap.util.arrays import Floats

STEPS = 20_000


def places(
    kind: str, parameters: tuple[float, ...], length: float, end: float, along: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return u, v and the turn at distances along a curve, in m; `end` is the parameter where a cubic ends."""
    if kind in ("poly3", "paramPoly3"):
        if kind == "poly3":
            parameters = (0.0, 1.0, 0.0, 0.0, *parameters)
        p = np.linspace(0.0, end, STEPS + 1)
        u, v = (np.polynomial.Polynomial(factors)(p) for factors in (parameters[:4], parameters[4:]))
        ahead, left = (np.polynomial.Polynomial(factors).deriv()(p) for factors in (parameters[:4], parameters[4:]))
        far = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))))
        turn = np.unwrap(np.arctan2(left, ahead))
        beyond = np.maximum(along - far[-1], 0.0)
        u_there = np.interp(along, far, u) + beyond * np.cos(turn[-1])
        return u_there, np.interp(along, far, v) + beyond * np.sin(turn[-1]), np.interp(along, far, turn)
    first, last = {"line": (0.0, 0.0), "arc": parameters * 2, "spiral": parameters}[kind]
    s = np.linspace(0.0, length, STEPS + 1)
    turn = first * s + (last - first) / length * s**2 / 2
    middle = (turn[1:] + turn[:-1]) / 2
    u, v = (np.concatenate(([0.0], np.cumsum(values))) * length / STEPS for values in (np.cos(middle), np.sin(middle)))
    return np.interp(along, s, u), np.interp(along, s, v), np.interp(along, s, turn)

"""Offner relay: a concave and a convex sphere about one centre image a point beside it at unit magnification."""

"""Newtonian telescope with rough, dusty mirrors and black walls."""

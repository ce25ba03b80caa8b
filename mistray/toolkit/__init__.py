"""Toolkit of analyses: a request stated once gives its signature, options and help; rows give all tables."""

"""Toolkit of analyses: signatures and options from requests, tables from rows; pages, figures, drawings and PDF."""

"""Ritchey-Chrétien telescope with a spider of four vanes, polished mirrors and dust, in a black tube."""

"""A lens behind a two-stage baffle with vanes, as of a star tracker."""

"""Thermal self-emission of a system on its detector: irradiance, narcissus and NETD."""

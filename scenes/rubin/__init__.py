"""The Rubin telescope with its camera, surfaces as measured: three mirrors, three lenses and the r filter."""

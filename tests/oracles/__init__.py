"""Independent float64 oracles for the tests.

Pure numpy: nothing here imports mistray, mitsuba or drjit, so an error there cannot hide here. Units are mm, nm and W;
angles are radians inside and degrees only in names that end in ``_deg``.

glass          refractive indices from material strings
geometry       first hits on surfaces of revolution and stock shapes
interface      Snell, Fresnel, ideal and tabulated coatings
scene_xml      reads a scene XML into a plain model
beams          deterministic start rays of the collimated source
replay         sequential trace through a prescribed list of events
nonsequential  split tracer: ledger of every path, energy budget, leaks between media
closed_forms   plates, paraxial ghosts, ghost counts
small_scenes   XML texts of plates and other small scenes
colour         the CIE observer at a few wavelengths, sRGB by its definition, coatings in air
scatter_integrals  scattered flux by quadrature: view factors, tubes, spheres, cones, plates, double scatter
scatter_scenes XML texts of surfaces that scatter, of targets, and of scenes with them
scatter        slow Monte Carlo tracer for surfaces that scatter
layers         R and T of stacks of layers by characteristic matrices
frozen_scene   a scene as one list of numbers that can be moved
frozen_paths   recorded rays followed again while a number moves: the derivatives of metrics on frozen paths
derivatives    central differences of fourth order
statistics     z-tests that say by how much they fail
"""

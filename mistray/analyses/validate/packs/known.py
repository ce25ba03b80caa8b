"""All built-in packs of reference numbers, in the order of the report."""

from __future__ import annotations

from mistray.analyses.validate.pack import Pack, Peer
from mistray.analyses.validate.packs import films, glare, objects, roughness, spheres, telescopes, tracepro
from mistray.analyses.validate.scene_numbers import SceneNumbers

BATOID = Peer("batoid", "pip install 'mistray[batoid]'", telescopes.asked)
TMM = Peer("tmm", "pip install 'mistray[validate]'", films.asked)
MIEPYTHON = Peer("miepython", "pip install 'mistray[validate]'", spheres.asked)
SCATMECH = Peer("pySCATMECH", "pip install 'mistray[scatmech]'", roughness.asked)

PACKS = (
    Pack("rubin_ghosts", SceneNumbers),
    Pack("lsst", telescopes.TelescopeNumbers, BATOID),
    Pack("hsc", telescopes.TelescopeNumbers, BATOID),
    Pack("decam", telescopes.TelescopeNumbers, BATOID),
    Pack("phone_camera", SceneNumbers),
    Pack("phone_camera_pst", SceneNumbers),
    Pack("phone_camera_objects", objects.ours),
    Pack("veiling_glare", glare.ours),
    Pack("tracepro_abg", tracepro.ours),
    Pack("scatmech", roughness.ours, SCATMECH),
    Pack("thin_films", films.ours, TMM),
    Pack("mie_spheres", spheres.ours, MIEPYTHON),
)

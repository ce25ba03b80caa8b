"""
Ratios of path densities, from which `mistray.sampling.sharing.mis_weights` makes the MIS weights of both directions.

Forward and backward rays build the same paths. The balance heuristic (E. Veach, Robust Monte Carlo methods for light
transport simulation, 1997, section 9.2) weights a path by the density of each technique. Here "own" is the direction of
the ray and "rev" the other one, and a ray carries along its path

    pdf_ratio = ∏ pdf_rev/pdf_own over its scatter events,
    survival_ratio = ∏ q_rev/q_own since the last of them,

where pdf is a density per étendue and q a probability of survival (Russian roulette). Both change only where rays draw
at random; reflection and refraction keep étendue, and leave them as they are:

- Scatter draws directions with densities of its own in either direction.
- A hit scatters, and a reflection before the first scatter event is followed, with the probabilities of
  `mistray.kernel.kernel_scene.BranchProbabilities`.
- Below `scatter_threshold` a scattered ray plays roulette, and an unscattered one scatters by roulette, so that both
  directions have the same q between scatter events and at either side of them. Backward rays scatter at walls whatever
  their throughput, see `mistray.kernel.branching.DARK_THRESHOLD_SHARE`; forward rays that a wall has scattered play
  roulette on their way to the detector. With ``splitting="one"`` the throughput of a ray says nothing of these
  probabilities, and both directions leave them out.

Both directions must come to the same ratio for the same path: only then do their MIS weights add to 1. A third
technique connects backward rays to light vertices; the two values for its density are partial MIS weights as those of
T. Davidovič et al. (Progressive light transport simulation on the GPU, 2014), see `PdfRatios.connection_ratios`.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from mistray.kernel.interaction import Interaction
from mistray.kernel.kernel_scene import KernelScene
from mistray.recorders.path_key import AT_WALL, COUNT_MASK
from mistray.settings import Settings

State = dict[str, Any]


class PdfRatios:
    """
    Ratios of reverse to own path densities, which rays carry for MIS weights and which events change.

    Parameters
    ----------
    scene : KernelScene
        Scene with a competing trace.
    settings : Settings
        Settings of the trace.
    """

    def __init__(self, scene: KernelScene, settings: Settings) -> None:
        assert scene.competing is not None
        assert scene.probabilities is not None
        self.connects, self._media_n = scene.competing.connects, scene.table.optics.media_n
        self._backward, self._scatters = scene.backward, scene.scatters(settings)
        self._own, self._rev = scene.probabilities, scene.competing.probabilities
        # Where one child takes the flux of all, no share of it lowers the throughput
        self._by_weight = settings.splitting == "split"
        self._threshold = dr.opaque(mi.Float, settings.scatter_threshold)

    @staticmethod
    def first(width: int, connected_width: int) -> State:
        """
        Return the density ratios of `width` start rays before any event, by name, as loop variables.

        Those of connections have `connected_width` entries.
        """
        return {
            "pdf_ratio": dr.full(mi.Float, 1, width),  # ∏ pdf_rev/pdf_own over the scatter events so far
            "survival_ratio": dr.full(mi.Float, 1, width),  # ∏ q_rev/q_own since the last of them
            "partial_ratio": dr.zeros(mi.Float, connected_width),  # factors of the next one, see `connection_ratios`
            "connection_ratio": dr.zeros(mi.Float, connected_width),  # connections per ray and per light vertex
        }

    def after(
        self,
        state: State,
        share: mi.Float,
        wall: mi.Bool,
        by_roulette: mi.Bool,
        scatter: mi.Bool,
        by_medium: mi.Bool,
        pdf_ratio: mi.Float,
    ) -> State:
        """
        Return the density ratios of rays after an event at a node, as variables of the loop.

        Parameters
        ----------
        state : dict
            Variables of the loop at the node.
        share : mi.Float
            R or T of the node.
        wall : mi.Bool
            Whether the node is at an opaque surface.
        by_roulette : mi.Bool
            Reflections that unscattered rays, of whichever direction, follow by roulette.
        scatter, by_medium : mi.Bool
            Whether the surface scatters the ray, and whether the medium before it does.
        pdf_ratio : mi.Float
            pdf_rev/pdf_own of the scattered direction, see `mistray.kernel.scattering.Scattering.scatter`.
        """
        scattered = scatter | by_medium
        unscattered = (state["scatters"] & COUNT_MASK) == 0
        # Roulette of reflections: this direction plays it before its first scatter event, the other one after its last
        specular = dr.select(by_roulette & unscattered, dr.rcp(self._own.reflection), 1)
        survival_ratio = dr.select(by_roulette, self._rev.reflection, 1)
        if self._scatters:
            # Probabilities with which the hit scatters in either direction
            own, rev = (dr.gather(mi.Float, each.scatter, state["s"], scatter) for each in (self._own, self._rev))
            pdf_ratio = pdf_ratio * rev / own
            # Roulette below `scatter_threshold`, at walls
            if self._backward:
                pdf_ratio = pdf_ratio * dr.select(unscattered & wall, self._survival(state, mi.Float(1)), 1)
            else:
                from_wall = (state["scatters"] & AT_WALL) != 0
                survival_ratio = survival_ratio / dr.select(from_wall, self._survival(state, share), 1)
        return {
            "pdf_ratio": state["pdf_ratio"] * dr.select(scatter, pdf_ratio, dr.select(by_medium, 1, specular)),
            "survival_ratio": dr.select(scattered, 1, state["survival_ratio"] * survival_ratio),
        }

    def connection_ratios(
        self,
        state: State,
        it: Interaction,
        heading: mi.Vector3f,
        medium: mi.UInt32,
        pdf_rev: mi.Float,
        scatter: mi.Bool,
        by_medium: mi.Bool,
        length: mi.Float,
    ) -> State:
        """
        Return the partial densities that give the number of connections to light vertices on the same path.

        Let z be the second scatter event of a path, seen from the light, and y the first. A backward ray can also go as
        far as z and be connected to a light vertex at y. With q light vertices at y per étendue n² cos θ dω dA for each
        connection, there are

            q n² cos θ_in r²/(cos θ_out pdf_z pdf_y)

        connections for each ray that goes all the way. The angles are those of the light and of the connection at y, r
        is the length from y to z, and pdf_z and pdf_y are the rays per sr that z sends backward to y, and y backward to
        the light. "connection_ratio" is that without q, and 0 where light does not go straight from y to z;
        "partial_ratio" holds the factors that are known between the two events.

        Parameters
        ----------
        state : dict
            Variables of the loop at the node.
        it : Interaction
            Interaction at the hits.
        heading : mi.Vector3f
            Unit direction of the ray that the node sends on.
        medium : mi.UInt32
            Position in `Optics.media` of the medium through which the light comes to the node.
        pdf_rev : mi.Float
            Backward rays per sr, see `mistray.kernel.scatter_shares.ScatterPdfs`.
        scatter, by_medium : mi.Bool
            Whether the surface scatters the ray, and whether the medium before it does.
        length : mi.Float
            Length to the next surface, mm.
        """
        n2, r2 = dr.square(dr.gather(mi.Float, self._media_n, medium)), dr.square(length)
        cos_out = dr.abs(dr.dot(heading, it.axis))
        partial, ratio = state["partial_ratio"], state["connection_ratio"]
        if self._backward:
            # Every scatter event may be y, and the one before it z: the last two count
            found = n2 * cos_out / (it.cos_i * pdf_rev * partial)
            found = dr.select((partial > 0) & dr.isfinite(found), found, 0)
            ratio = dr.select(scatter, found, dr.select(by_medium, 0, ratio))
            return {"partial_ratio": dr.select(scatter, pdf_rev / r2, 0), "connection_ratio": ratio}
        # Forward rays meet y first, then z
        count = state["scatters"] & COUNT_MASK
        at_y, at_z = scatter & (count == 0), scatter & (count == 1)
        # Rays that have followed reflections by roulette are fewer, which their density ratio says
        begun = n2 * it.cos_i / (cos_out * pdf_rev * state["pdf_ratio"]) * r2
        found = partial / pdf_rev
        ratio = dr.select(at_z & dr.isfinite(found), found, ratio)
        return {"partial_ratio": dr.select(at_y & dr.isfinite(begun), begun, 0), "connection_ratio": ratio}

    def connection_ratio_at_end(self, state: State) -> mi.Float | None:
        """Return the expected connections that find a complete path, per ray and light vertex; None if none is made."""
        if not self.connects:
            return None
        return state["connection_ratio"] * state["survival_ratio"] if self._backward else state["connection_ratio"]

    def at_end(self, state: State) -> mi.Float:
        """Return the density ratio pdf_rev/pdf_own of complete paths, which end at the detector or leave the scene."""
        ratio = state["pdf_ratio"] * state["survival_ratio"]
        if self._backward or not self._scatters:
            return ratio
        return ratio / dr.select((state["scatters"] & AT_WALL) != 0, self._survival(state, mi.Float(1)), 1)

    def _survival(self, state: State, share: mi.Float) -> mi.Float:
        """
        Return the probability that roulette spares a ray that has this share, 0 … 1, of its node's throughput.

        It is 1 with ``splitting="one"``.
        """
        if not self._by_weight:
            return mi.Float(1)
        return dr.minimum(state["w"] * share / (state["reference"] * self._threshold), 1)

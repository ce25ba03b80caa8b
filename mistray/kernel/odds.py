"""
How many rays the other direction has for one of this, along the path that a ray has taken.

Rays with the light and rays against it find the same paths, see `mistray.sampling.sharing.balance`. Each ray keeps one
number: how many rays of the other direction, per étendue, take the path so far for one of this direction. Reflection
and refraction leave it as it is; what scatters, and what lets rays go on by chance, changes it:

- Scatter draws directions with densities of its own in either direction.
- Rays scatter at a surface, and are followed in a reflection before their first scatter, with given probabilities, see
  `mistray.kernel.kernel_scene.BranchProbabilities`.
- Below the threshold of scatter a ray that has been scattered plays roulette, and one that has not been scatters by
  chance, so that both directions have the same chances between scatter events and on either side of them. At a wall
  rays against the light scatter whatever is left of them, see `mistray.kernel.branching.WORTH_IN_THE_DARK`; those with
  the light that the wall has scattered play roulette on their way to the detector. With ``splitting="one"`` the weight
  of a ray says nothing of these chances, and both directions leave them out.

Both directions must come to the same number for the same path: shares of them add to 1 only then.
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


class Odds:
    """
    The odds of rays, and what changes them.

    Parameters
    ----------
    scene : KernelScene
        That knows the other direction.
    settings : Settings
    """

    def __init__(self, scene: KernelScene, settings: Settings) -> None:
        assert scene.opposite is not None
        assert scene.probabilities is not None
        self.connects, self._media_n = scene.opposite.connects, scene.table.optics.media_n
        self._backward, self._scatters = scene.backward, scene.scatters(settings)
        self._own, self._other = scene.probabilities, scene.opposite.probabilities
        # One child takes the flux of all, so that no share of it lowers the weight
        self._by_weight = settings.splitting == "split"
        self._threshold = dr.opaque(mi.Float, settings.scatter_threshold)

    @staticmethod
    def first(width: int, connected_width: int) -> State:
        """Variables of the loop at the start of rays."""
        return {
            # Rays of the other direction for one of this, by what has scattered it, and since it was scattered
            "odds": dr.full(mi.Float, 1, width),
            "chance": dr.full(mi.Float, 1, width),
            # See `linked`
            "near": dr.zeros(mi.Float, connected_width),
            "link": dr.zeros(mi.Float, connected_width),
        }

    def after(
        self,
        state: State,
        share: mi.Float,
        wall: mi.Bool,
        thinned: mi.Bool,
        scatter: mi.Bool,
        cloud: mi.Bool,
        odds: mi.Float,
    ) -> State:
        """
        The variables of rays that nodes send on.

        Parameters
        ----------
        state : dict
            Of the loop, at the node.
        share : mi.Float
            R or T.
        wall : mi.Bool
            Whether the node is at a surface that lets nothing through.
        thinned : mi.Bool
            Reflections that rays against the light follow by chance, if nothing has scattered them.
        scatter, cloud : mi.Bool
            Whether the surface scatters the ray, and whether the medium does.
        odds : mi.Float
            Of the direction that it is scattered to, see `mistray.kernel.scattering.Scattering.scatter`.
        """
        scattered = scatter | cloud
        fresh = (state["scatters"] & COUNT_MASK) == 0
        specular = dr.select(thinned & fresh, dr.rcp(self._own.reflection), 1)
        chance = dr.select(thinned, self._other.reflection, 1)
        if self._scatters:
            own, other = (dr.gather(mi.Float, one.scatter, state["s"], scatter) for one in (self._own, self._other))
            odds = odds * other / own
            if self._backward:
                odds = odds * dr.select(fresh & wall, self._survival(state, mi.Float(1)), 1)
            else:
                chance = chance / dr.select((state["scatters"] & AT_WALL) != 0, self._survival(state, share), 1)
        return {
            "odds": state["odds"] * dr.select(scatter, odds, dr.select(cloud, 1, specular)),
            "chance": dr.select(scattered, 1, state["chance"] * chance),
        }

    def linked(
        self,
        state: State,
        it: Interaction,
        heading: mi.Vector3f,
        medium: mi.UInt32,
        against: mi.Float,
        scatter: mi.Bool,
        cloud: mi.Bool,
        length: mi.Float,
    ) -> State:
        """
        The variables of rays that nodes send on, from which follows how many connections find the same path.

        A path is also found by a ray against the light that goes as far as its second scatter event z, as seen from the
        light, and is connected to its first, y. For one ray that goes all the way that is, where q points of light lie
        at y per étendue n² cos θ dω dA for each connection,

            q n² cos θ_in r²/(cos θ_out b_z b_y)

        with the angles of the light and of the connection at y, the length r, and the rays per sr that z sends towards
        y and y against the light. "link" is that without q, 0 where light goes another way from y to z than straight;
        "near" is what is known of it between the two events.

        Parameters
        ----------
        state : dict
            Of the loop, at the node.
        it : Interaction
        heading : mi.Vector3f
            Of the ray that the node sends on.
        medium : mi.UInt32
            Through which the light comes to the node.
        against : mi.Float
            See `mistray.kernel.scatter_shares.Rivalry`.
        scatter, cloud : mi.Bool
            Whether the surface scatters the ray, and whether the medium does.
        length : mi.Float
            To the next surface, mm.
        """
        n2, r2 = dr.square(dr.gather(mi.Float, self._media_n, medium)), dr.square(length)
        cos_on = dr.abs(dr.dot(heading, it.axis))
        near, link = state["near"], state["link"]
        if self._backward:
            found = n2 * cos_on / (it.cos_i * against * near)
            link = dr.select(scatter, dr.select((near > 0) & dr.isfinite(found), found, 0), dr.select(cloud, 0, link))
            return {"near": dr.select(scatter, against / r2, 0), "link": link}
        count = state["scatters"] & COUNT_MASK
        first, second = scatter & (count == 0), scatter & (count == 1)
        # Rays that have followed reflections by chance are fewer: their odds say so
        begun = n2 * it.cos_i / (cos_on * against * state["odds"]) * r2
        found = near / against
        link = dr.select(second & dr.isfinite(found), found, link)
        return {"near": dr.select(first & dr.isfinite(begun), begun, 0), "link": link}

    def link_at_end(self, state: State) -> mi.Float | None:
        """Of rays that have come to the detector, or that leave the scene."""
        if not self.connects:
            return None
        return state["link"] * state["chance"] if self._backward else state["link"]

    def at_end(self, state: State) -> mi.Float:
        """Of rays that have come to the detector, or that leave the scene."""
        odds = state["odds"] * state["chance"]
        if self._backward or not self._scatters:
            return odds
        return odds / dr.select((state["scatters"] & AT_WALL) != 0, self._survival(state, mi.Float(1)), 1)

    def _survival(self, state: State, share: mi.Float) -> mi.Float:
        """Probability that a share of a node's light is followed which plays roulette."""
        if not self._by_weight:
            return mi.Float(1)
        return dr.minimum(state["w"] * share / (state["birth"] * self._threshold), 1)

"""Launches of the kernel that traces the ray trees of start rays, forward or backward."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mistray.kernel.kernel_scene import KernelScene
from mistray.kernel.launches import Launches, launches_of
from mistray.kernel.ray_tree import trace_tree
from mistray.recorders.recorder import Recorder, Recorders
from mistray.recorders.start_rays import StartRays
from mistray.settings import Settings


def launches_and_kernel(
    scene: KernelScene, settings: Settings, recorders: Sequence[Recorder | None], kind: Settings | None = None
) -> tuple[Launches, Callable[[StartRays], None]]:
    """
    Return the `Launches` that size a kernel's launches, and a function that traces trees of start rays by that kernel.

    Parameters
    ----------
    scene : KernelScene
        Scene at one wavelength, as the kernel sees it.
    settings : Settings
        Settings of the trace.
    recorders : sequence of Recorder
        Recorders that take the events of the rays, in this order; None is left out.
    kind : Settings, optional
        Settings that tell kernels of different speed apart; by default `settings`.
    """
    competing = None if scene.competing is None else scene.competing.connects
    code = Recorders(recorders).code
    launches = launches_of(scene.table, settings if kind is None else kind, code, scene.backward, competing)
    return launches, lambda start: trace_tree(scene, start, settings, recorders)


def trace_whole(
    scene: KernelScene,
    start: StartRays,
    settings: Settings,
    recorders: Sequence[Recorder | None],
    kind: Settings | None = None,
) -> Launches:
    """
    Trace the ray trees of all start rays regardless of the time budget; return the `Launches` of the kernel.

    The other parameters are those of `launches_and_kernel`.
    """
    launches, trace = launches_and_kernel(scene, settings, recorders, kind)
    launches.whole(start, trace)
    return launches

# SPDX-License-Identifier: Apache-2.0
"""A simulated gateway that serves its TCP port."""

import contextlib
import threading

from sim_bench import rig_of

from motord.config.drives.load import find_profile
from motord_hal.sim.control import SimControl
from motord_hal.sim.rig import PortSpec
from motord_hal.sim.runner import run


@contextlib.contextmanager
def served(folder, *, raw, faults=()):
    """Simulate a line over TCP; yield a client of its control socket, and its address."""
    profile = find_profile("zlac8015d")
    ports = {"bus": PortSpec(raw=raw)}
    stopped = threading.Event()
    with rig_of(profile, folder, ports=ports, faults=faults) as rig:
        host, _, port = rig.ports()["bus"].rpartition(":")
        thread = threading.Thread(target=run, args=(rig, stopped.is_set))
        thread.start()
        try:
            with SimControl(rig.server.path) as control:
                yield control, (host, int(port))
        finally:
            stopped.set()
            thread.join()

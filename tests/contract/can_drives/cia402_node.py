# SPDX-License-Identifier: Apache-2.0
"""A CiA 402 drive made of canopen's LocalNode: its SDO server, NMT slave and heartbeat are that
project's. PDOs are exchanged only as they were mapped in its object dictionary: by event, or by
SYNC if their transmission type demands it."""

from __future__ import annotations

import math
import threading
import time
from functools import partial

import can
import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

SWITCH_ON_DISABLED, READY, SWITCHED_ON, OPERATION = 0x40, 0x21, 0x23, 0x27
QUICK_STOP_ACTIVE, FAULT = 0x07, 0x08
U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I8, I16, I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
BITS = {U8: 8, U16: 16, U32: 32, I8: 8, I16: 16, I32: 32}
SIGNED = (I8, I16, I32)

VARIABLES = {
    0x1000: (U32, 0x00020192, "ro"), 0x1001: (U8, 0, "ro"), 0x1017: (U16, 0, "rw"),
    0x603F: (U16, 0, "ro"), 0x6040: (U16, 0, "rww"), 0x6041: (U16, SWITCH_ON_DISABLED, "ro"),
    0x605A: (I16, 1, "rw"), 0x6060: (I8, 0, "rw"), 0x6061: (I8, 0, "ro"),
    0x6064: (I32, 0, "ro"), 0x6065: (U32, 1000, "rw"), 0x6066: (U16, 0, "rw"),
    0x606C: (I32, 0, "ro"), 0x6077: (I16, 0, "ro"), 0x607A: (I32, 0, "rww"),
    0x6081: (U32, 0, "rw"), 0x6083: (U32, 0, "rw"), 0x6084: (U32, 0, "rw"),
    0x6071: (I16, 0, "rww"), 0x6072: (U16, 1000, "rw"), 0x6076: (U32, 1000, "ro"),
    0x6079: (U32, 36500, "ro"), 0x6080: (U32, 6000, "rw"), 0x60FF: (I32, 0, "rww"),
}  # fmt: skip

PDO_IDENTIFIERS = {0x1400: 0x200, 0x1401: 0x300, 0x1800: 0x180, 0x1801: 0x280}
SYNCHRONOUS_MAX = 240
NEW_SETPOINT, AT_ONCE, TAKEN = 0x10, 0x20, 0x1000
PROFILE_POSITION, POSITION_MODE, TORQUE_MODE, SYNC_S = 1, 8, 10, 0.005
INERTIA_KG_M2, RPM = 0.07, 2 * math.pi / 60


def dictionary(node):
    """Return a new drive's object dictionary: PDOs at default identifiers, mapped to nothing."""
    od = canopen.ObjectDictionary()
    for index, (kind, default, access) in VARIABLES.items():
        od.add_object(_variable(f"o{index:04X}", index, 0, kind, default, access))
    for index, identifier in PDO_IDENTIFIERS.items():
        entries = {0: (U8, 5), 1: (U32, identifier + node), 2: (U8, 1), 3: (U16, 0), 5: (U16, 0)}
        od.add_object(_record(index, entries))
    for index in (0x1600, 0x1601, 0x1A00, 0x1A01):
        od.add_object(_record(index, {0: (U8, 0)} | dict.fromkeys(range(1, 9), (U32, 0))))
    od.add_object(_record(0x60C2, {0: (U8, 2), 1: (U8, 1), 2: (I8, -3)}))
    return od


def _variable(name, index, sub, kind, default, access="rw"):
    variable = ODVariable(name, index, sub)
    variable.data_type, variable.default, variable.access_type = kind, default, access
    return variable


def _record(index, entries):
    record = ODRecord(f"o{index:04X}", index)
    for sub, (kind, default) in entries.items():
        record.add_member(_variable(f"o{index:04X}s{sub}", index, sub, kind, default))
    return record


class Cia402Node:
    """Node, state machine and PDO exchange; a thread of its own sends the PDOs of event timers."""

    def __init__(self, bus, node):
        self.node_id = node
        self.status, self.controls, self.velocities = SWITCH_ON_DISABLED, [], []
        self.operational_at = []
        """For each control word: whether the node was operational when it came."""
        self._sent_s = 0.0
        self.error_code = 0
        self.position, self.velocity, self.torque = 0, 0, 0
        self.torques = []
        self.target, self.targets = 0, []
        """Each received target position with the status word's state at that time."""
        self.taken = []
        """Targets that were taken in profile position mode."""
        self.more_status = 0
        """Bits that the status word has in addition to those of the state."""
        self.stuck = False
        self.syncs, self.waiting = 0, {}
        self.network = canopen.Network(bus)
        self.network.notifier = can.Notifier(self.network.bus, self.network.listeners, 0.01)
        self.node = canopen.LocalNode(node, dictionary(node))
        self.network.add_node(self.node)
        self.node.add_write_callback(self._written)
        for communication in (0x1400, 0x1401):
            identifier = PDO_IDENTIFIERS[communication] + node
            self.network.subscribe(identifier, partial(self._rpdo, communication))
        self.network.subscribe(0x080, self._sync)
        self._stopped = threading.Event()
        self._sender = threading.Thread(target=self._send_pdos)
        self._sender.start()

    def close(self):
        self._stopped.set()
        self._sender.join()
        self.network.notifier.stop()  # its thread starts heartbeats
        self.network.bus.stop_all_periodic_tasks()
        for thread in threading.enumerate():
            if thread.name == f"Cyclic send task for 0x{0x700 + self.node_id:X}":
                thread.join()  # otherwise it may send on a closed bus
        self.network.disconnect()

    def reboot(self):
        """Restart the node with its factory settings."""
        self.node.nmt.stop_heartbeat()
        self.node.data_store.clear()
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.status = SWITCH_ON_DISABLED
        self.waiting.clear()

    def get(self, index, sub=0):
        variable = self.node.object_dictionary.get_variable(index, sub)
        stored = self.node.data_store.get(index, {}).get(sub)
        return variable.default if stored is None else variable.decode_raw(stored)

    def put(self, index, value):
        variable = self.node.object_dictionary[index]
        self.node.data_store.setdefault(index, {})[0] = variable.encode_raw(value)

    def _written(self, *, index, od, data, **_):
        if index == 0x6040:
            self.control(od.decode_raw(data))
        elif index == 0x6060:
            self.put(0x6061, od.decode_raw(data))

    def _mapping(self, index):
        entries = [self.get(index, sub) for sub in range(1, self.get(index, 0) + 1)]
        return [(entry >> 16, entry & 0xFF) for entry in entries]

    @property
    def silent_s(self):
        """Time since it received its newest control word."""
        return time.monotonic() - self._sent_s

    @property
    def operational(self):
        return self.node.nmt.state == "OPERATIONAL"

    def _rpdo(self, communication, identifier, data, stamp_s):
        if not self.operational or self.get(communication, 1) != identifier:
            return
        if self.get(communication, 2) <= SYNCHRONOUS_MAX:
            self.waiting[communication] = data
        else:
            self._obey(communication, data)

    def _sync(self, identifier, data, stamp_s):
        if not self.operational:
            return
        self.syncs += 1
        while self.waiting:
            self._obey(*self.waiting.popitem())
        self._turn()
        self._measure()
        self._send_mapped(by_sync=True)

    def _obey(self, communication, data):
        at, whole = 0, int.from_bytes(data, "little")
        for index, bits in self._mapping(communication + 0x200):
            raw = whole >> at & (1 << bits) - 1
            at += bits
            if index == 0x6040:
                self.control(raw)
            elif index == 0x60FF:
                speed = raw - (1 << bits) if raw >> (bits - 1) else raw
                self.velocities.append(speed)
                self.velocity = speed if self.status == OPERATION else 0
            elif index == 0x6071:
                self.torque = raw - (1 << bits) if raw >> (bits - 1) else raw
                self.torques.append(self.torque)
            elif index == 0x607A:
                self.target = raw - (1 << bits) if raw >> (bits - 1) else raw
                self.targets.append((self.target, self.status))

    def _turn(self):
        """Move for one SYNC period: in position mode to the target at once, in torque mode by the
        torque, in 0.1 % of 1 N m. Without power it does not move."""
        if self.get(0x6061) == POSITION_MODE and self.status == OPERATION:
            self.position = self.target
        if self.get(0x6061) == TORQUE_MODE:
            step = self.torque / 1000 / INERTIA_KG_M2 * SYNC_S / RPM
            self.velocity = self.velocity + step if self.status == OPERATION else 0

    def control(self, word):
        """Do one transition (CiA 402-2, 8.3); a rising edge of bit 7 resets a fault."""
        before = self.controls[-1] if self.controls else 0
        self.controls.append(word)
        self.operational_at.append(self.operational)
        self._sent_s = time.monotonic()
        if self.stuck:
            return
        self._take_target(before, word)
        rising = word & 0x80 and not before & 0x80
        if self.status == FAULT:
            if rising:
                self.status, self.error_code = SWITCH_ON_DISABLED, 0
        elif not word & 0x02:
            self.status = SWITCH_ON_DISABLED
        elif not word & 0x04:
            running = self.status in (OPERATION, QUICK_STOP_ACTIVE)
            self.status = QUICK_STOP_ACTIVE if running else SWITCH_ON_DISABLED
        elif self.status == SWITCH_ON_DISABLED and word & 0x07 == 0x06:
            self.status = READY
        elif self.status == READY and word & 0x07 == 0x07:
            self.status = SWITCHED_ON
        elif self.status == SWITCHED_ON and word & 0x0F == 0x0F:
            self.status = OPERATION
        elif word & 0x07 == 0x06 and self.status in (SWITCHED_ON, OPERATION):
            self.status = READY
        if self.status != OPERATION:
            self.velocity = 0

    def _take_target(self, before, word):
        """Take the target at a rising edge of bit 4 with bit 5 set (CiA 402-2, 10.3), and be there
        at once. The acknowledge bit stays until bit 4 falls."""
        if not word & NEW_SETPOINT:
            self.more_status &= ~TAKEN
        can_take = self.get(0x6061) == PROFILE_POSITION and self.status == OPERATION
        if can_take and word & ~before & NEW_SETPOINT and word & AT_ONCE:
            self.more_status |= TAKEN
            self.taken.append(self.target)
            self.position = self.target

    def _send_pdos(self):
        while not self._stopped.wait(0.01):
            self._measure()
            self._send_mapped(by_sync=False)

    def _measure(self):
        self.put(0x6041, self.status | self.more_status)
        self.put(0x603F, self.error_code)
        self.put(0x606C, round(self.velocity))
        self.put(0x6064, self.position)

    def _send_mapped(self, *, by_sync):
        for communication, mapping in ((0x1800, 0x1A00), (0x1801, 0x1A01)):
            identifier = self.get(communication, 1)
            synchronous = self.get(communication, 2) <= SYNCHRONOUS_MAX
            due = by_sync if synchronous else not by_sync and self.get(communication, 5)
            valid = self.operational and not identifier & 0x80000000
            if valid and due and self.get(mapping, 0):
                self.network.send_message(identifier & 0x7FF, self._packed(mapping))

    def _packed(self, mapping):
        whole, at = 0, 0
        for index, bits in self._mapping(mapping):
            whole |= (self.get(index) & (1 << bits) - 1) << at
            at += bits
        return whole.to_bytes(at // 8, "little")

/* SPDX-License-Identifier: Apache-2.0
 * drive_walk_table.h: the mode of a drive after every event in every mode, on all media. Read
 * by C (drive_walk.h) and by Python (tests/contract/lines/drive_walk.py); it has no include guard.
 *
 * LEADS_TO(event, the mode that it leads to from OFF, READY, ARMED, STOPPING, UNRESPONSIVE and
 * BACK). A quick stop lasts a second: the wheel turns. A silent drive reports no events. */
LEADS_TO(SETPOINTS_OLD, OFF, READY, READY, READY, UNRESPONSIVE, BACK)
LEADS_TO(SETPOINTS_NOT_ENABLED, OFF, READY, READY, READY, UNRESPONSIVE, BACK)
LEADS_TO(REQUESTED_OFF, OFF, OFF, OFF, OFF, UNRESPONSIVE, OFF)
LEADS_TO(REQUESTED_READY, READY, READY, ARMED, READY, UNRESPONSIVE, READY)
LEADS_TO(REQUESTED_ARMED, OFF, ARMED, ARMED, READY, UNRESPONSIVE, BACK)
LEADS_TO(REQUESTED_STAND_DOWN, OFF, READY, READY, READY, UNRESPONSIVE, BACK)
LEADS_TO(FALLS_SILENT, OFF, UNRESPONSIVE, UNRESPONSIVE, UNRESPONSIVE, UNRESPONSIVE, BACK)
LEADS_TO(ANSWERS_AGAIN, OFF, READY, ARMED, READY, BACK, BACK)
LEADS_TO(DISABLED_ITSELF, OFF, READY, OFF, READY, UNRESPONSIVE, BACK)
LEADS_TO(LOST_SETUP, OFF, OFF, OFF, OFF, UNRESPONSIVE, BACK)
LEADS_TO(STILL_ENABLED, OFF, READY, ARMED, READY, UNRESPONSIVE, BACK)
LEADS_TO(LINE_ENDS, OFF, READY, READY, READY, UNRESPONSIVE, BACK)

/* SENDS_POWER_OFF(event, from): holds for all media on which the event can occur. */
SENDS_POWER_OFF(SETPOINTS_NOT_ENABLED, ARMED)
SENDS_POWER_OFF(DISABLED_ITSELF, ARMED)
SENDS_POWER_OFF(LOST_SETUP, READY)
SENDS_POWER_OFF(LOST_SETUP, ARMED)
SENDS_POWER_OFF(LOST_SETUP, STOPPING)
SENDS_POWER_OFF(STILL_ENABLED, READY)

/* CANNOT_OCCUR(medium, event or ANY, from or ANY, why). Media: RS485, CAN, BOARD and BRIDGE in C;
 * ASYNCIO: Modbus and CAN in asyncio; ASYNCIO_CAN: only CAN in asyncio. */
CANNOT_OCCUR(CAN, LOST_SETUP, ANY, "no field of its table shows whether it has kept its set-up")
CANNOT_OCCUR(BRIDGE, ANY, OFF, "it has no set-up: it is READY as soon as its thread runs")
CANNOT_OCCUR(BRIDGE, ANY, UNRESPONSIVE, "it gives no replies that could fail to come")
CANNOT_OCCUR(BRIDGE, ANY, BACK, "it gives no replies that could fail to come")
CANNOT_OCCUR(BRIDGE, FALLS_SILENT, ANY, "it gives no replies that could fail to come")
CANNOT_OCCUR(BRIDGE, ANSWERS_AGAIN, ANY, "it gives no replies that could come again")
CANNOT_OCCUR(BRIDGE, DISABLED_ITSELF, ANY, "nothing on its pins reports whether it has power")
CANNOT_OCCUR(BRIDGE, STILL_ENABLED, ANY, "nothing on its pins reports whether it has power")
CANNOT_OCCUR(BRIDGE, LOST_SETUP, ANY, "it has no set-up that could be lost")
CANNOT_OCCUR(BRIDGE, REQUESTED_OFF, ANY,
             "it has no set-up that could be undone: PWM_OFF is its stand-down")
CANNOT_OCCUR(BRIDGE, REQUESTED_READY, ANY, "it has no set-up that could be requested")
CANNOT_OCCUR(ASYNCIO, ANY, BACK,
             "its set-up begins as soon as it answers: it is OFF until it is READY")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, READY,
             "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, ARMED,
             "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, STOPPING,
             "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, UNRESPONSIVE,
             "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO_CAN, LOST_SETUP, ANY,
             "the line reads nothing that shows whether it has kept its set-up")

/* DIFFERS(medium, event, from, mode to which the event leads on this medium, why) */
DIFFERS(ASYNCIO, REQUESTED_OFF, UNRESPONSIVE, OFF,
        "the loss of its medium requests it: no probe goes out any more")
DIFFERS(ASYNCIO, FALLS_SILENT, OFF, UNRESPONSIVE, "the line sets it up, and gets no reply")
DIFFERS(ASYNCIO, LINE_ENDS, READY, OFF,
        "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, LINE_ENDS, ARMED, OFF,
        "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, LINE_ENDS, STOPPING, OFF,
        "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, LINE_ENDS, UNRESPONSIVE, OFF,
        "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, ANSWERS_AGAIN, UNRESPONSIVE, READY, "the line sets it up again by itself")
DIFFERS(ASYNCIO, DISABLED_ITSELF, ARMED, READY, "the line sets it up again by itself")
DIFFERS(ASYNCIO, LOST_SETUP, READY, READY, "the line sets it up again by itself")
DIFFERS(ASYNCIO, LOST_SETUP, ARMED, READY, "the line sets it up again by itself")
DIFFERS(ASYNCIO, LOST_SETUP, STOPPING, READY, "the line sets it up again by itself")

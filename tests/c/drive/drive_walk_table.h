/* SPDX-License-Identifier: Apache-2.0
 * drive_walk_table.h: what becomes of a drive in every mode after every event, on all media. Read by C (drive_walk.h) and by
 * Python (tests/contract/lines/drive_walk.py); it has no include guard.
 *
 * LEADS_TO(event, the mode that it leads to from OFF, READY, ARMED, STOPPING and UNRESPONSIVE). A quick stop goes on for a
 * second: the wheel turns. */
LEADS_TO(SETPOINTS_OLD, OFF, READY, READY, READY, UNRESPONSIVE)
LEADS_TO(SETPOINTS_NOT_ENABLED, OFF, READY, READY, READY, UNRESPONSIVE)
LEADS_TO(REQUESTED_OFF, OFF, OFF, OFF, OFF, OFF)
LEADS_TO(REQUESTED_READY, READY, READY, ARMED, READY, UNRESPONSIVE)
LEADS_TO(REQUESTED_ARMED, OFF, ARMED, ARMED, READY, UNRESPONSIVE)
LEADS_TO(REQUESTED_STAND_DOWN, OFF, READY, READY, READY, UNRESPONSIVE)
LEADS_TO(FALLS_SILENT, OFF, UNRESPONSIVE, UNRESPONSIVE, UNRESPONSIVE, UNRESPONSIVE)
LEADS_TO(LINE_ENDS, OFF, READY, READY, READY, UNRESPONSIVE)

/* CANNOT_OCCUR(medium, event or ANY, from or ANY, why). Media: RS485, CAN, BOARD, BRIDGE in C; ASYNCIO: Modbus and CAN there. */
CANNOT_OCCUR(BRIDGE, ANY, OFF, "it has no set-up: it is READY as soon as its thread runs")
CANNOT_OCCUR(BRIDGE, ANY, UNRESPONSIVE, "it gives no replies that could fail to come")
CANNOT_OCCUR(BRIDGE, FALLS_SILENT, ANY, "it gives no replies that could fail to come")
CANNOT_OCCUR(BRIDGE, REQUESTED_OFF, ANY, "it has no set-up that could be undone: PWM_OFF is its stand-down")
CANNOT_OCCUR(BRIDGE, REQUESTED_READY, ANY, "it has no set-up that could be requested")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, READY, "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, ARMED, "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, STOPPING, "the end of a set-up requests it, and only in OFF one goes on")
CANNOT_OCCUR(ASYNCIO, REQUESTED_READY, UNRESPONSIVE, "the end of a set-up requests it, and only in OFF one goes on")

/* DIFFERS(medium, event, from, the mode that it leads to there, why) */
DIFFERS(ASYNCIO, FALLS_SILENT, OFF, UNRESPONSIVE, "the line sets it up, and gets no reply")
DIFFERS(ASYNCIO, LINE_ENDS, READY, OFF, "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, LINE_ENDS, ARMED, OFF, "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, LINE_ENDS, STOPPING, OFF, "the medium is closed after the power-off: nothing is known of the drive")
DIFFERS(ASYNCIO, LINE_ENDS, UNRESPONSIVE, OFF, "the medium is closed after the power-off: nothing is known of the drive")

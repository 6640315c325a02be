# SPDX-License-Identifier: Apache-2.0
"""Serial lines whose cycle runs in C: Modbus RTU, DDSM, RoboClaw and bus servos."""

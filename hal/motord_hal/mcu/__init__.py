# SPDX-License-Identifier: Apache-2.0
"""Boards that people program themselves, on a serial port, with a stream of frames in each
direction."""

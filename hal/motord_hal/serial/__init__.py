# SPDX-License-Identifier: Apache-2.0
"""Serial ports: search, exclusive opening, settings, and the direction of RS485 transceivers."""

# SPDX-License-Identifier: Apache-2.0
"""MQTT: topics on a broker, and commands from it."""

# SPDX-License-Identifier: Apache-2.0
"""Sabertooth motor drivers in packet serial mode."""

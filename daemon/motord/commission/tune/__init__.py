# SPDX-License-Identifier: Apache-2.0
"""Tune the speed loop of a wheel from a recorded step: motord tune."""

# SPDX-License-Identifier: Apache-2.0
"""Prometheus: figures by HTTP."""

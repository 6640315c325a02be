# SPDX-License-Identifier: Apache-2.0
"""Who is told and who may tell: buses. No devices, no C core."""

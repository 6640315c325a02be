# SPDX-License-Identifier: Apache-2.0
"""Commands for robot files, for drive profiles and for files that are made from them."""

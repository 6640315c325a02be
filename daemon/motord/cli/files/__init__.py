# SPDX-License-Identifier: Apache-2.0
"""Commands for robot files, drive profiles and what is written from them."""

# SPDX-License-Identifier: Apache-2.0
"""One wheel at a time turns, and the robot file is put right: motord spin."""

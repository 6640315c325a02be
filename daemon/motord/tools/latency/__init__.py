# SPDX-License-Identifier: Apache-2.0
"""`motord latency`: measures how late the real-time loop is on this machine."""

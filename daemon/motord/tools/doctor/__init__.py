# SPDX-License-Identifier: Apache-2.0
"""`motord doctor`: what is wrong with this machine, its devices, the drives, and a running daemon,
each with the command that fixes it."""

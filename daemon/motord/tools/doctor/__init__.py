# SPDX-License-Identifier: Apache-2.0
"""`motord doctor`: finds problems of this machine, its devices, the drives and a running daemon,
and shows for each the command that fixes it."""

# SPDX-License-Identifier: Apache-2.0
"""What other nodes call: services, parameters, the life cycle and actions."""

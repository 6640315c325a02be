# SPDX-License-Identifier: Apache-2.0
"""What other nodes can call: services, parameters, the life cycle and actions."""

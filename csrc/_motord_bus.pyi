# SPDX-License-Identifier: Apache-2.0
# For type checkers only. The names' meaning is in api_bus.h; cffi checks their types at run time.
from typing import Any

ffi: Any
lib: Any

"""Lu et al. 2019: the numbers behind each table and figure, one function per item, each giving one
frame.
"""

from .common import METHODS
from .cost import operations, table2
from .readings import readings
from .setting import fig2, fig3, table1
from .trials import errata, fig4, nees

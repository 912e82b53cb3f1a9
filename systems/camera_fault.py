"""What can befall a camera: it is covered, it gets dark, its picture freezes."""

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State
from pydrake.systems.sensors import ImageRgba8U

from systems.arguments import require_count, require_positive

CLEAR, COVERED, DARKENED, FROZEN = range(4)
FAULTS = ("clear", "covered", "darkened", "frozen")
BRIGHTNESS = 0.25  # of a darkened picture, of what it was


class CameraFault(LeafSystem):
    """Passes the picture through, except while a fault says otherwise.

    .. pydrake_system::

        name: CameraFault
        input_ports: [rgb_image, fault]
        output_ports: [faulty_image]

    Inputs:
        rgb_image: ImageRgba8U of width x height pixels.
        fault: (1,) the place in FAULTS.
    Outputs:
        faulty_image: ImageRgba8U of the same size. CLEAR: the input; COVERED: black; DARKENED: BRIGHTNESS times the
            input; FROZEN: the picture of the tick at which it froze. Direct feedthrough of both.

    The frozen picture, and whether there is one, are abstract state, written at the ticks.
    """

    def __init__(self, width: int, height: int, period: float = 0.1):
        """`width`, `height`: of the picture, pixels; `period`: of the ticks, s."""
        super().__init__()
        self._size = require_count("width", width), require_count("height", height)
        picture = AbstractValue.Make(ImageRgba8U(*self._size))
        self._image = self.DeclareAbstractInputPort("rgb_image", picture)
        self._fault = self.DeclareVectorInputPort("fault", 1)
        self._frozen = self.DeclareAbstractState(picture)
        self._is_frozen = self.DeclareAbstractState(AbstractValue.Make(False))
        self.DeclareAbstractOutputPort(
            "faulty_image", picture.Clone, self._calc_image, {self.all_input_ports_ticket(), self.all_state_ticket()}
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(require_positive("period", period), 0.0, self._update)

    def _kind(self, context: Context) -> int:
        return min(max(round(self._fault.Eval(context)[0]), CLEAR), FROZEN)

    def _update(self, context: Context, state: State) -> EventStatus:
        freezes, was = self._kind(context) == FROZEN, context.get_abstract_state(int(self._is_frozen)).get_value()
        if freezes == was:
            return EventStatus.DidNothing()
        values = state.get_mutable_abstract_state()
        if freezes:
            values.get_mutable_value(int(self._frozen)).set_value(self._image.Eval(context))
        values.get_mutable_value(int(self._is_frozen)).set_value(freezes)
        return EventStatus.Succeeded()

    def _calc_image(self, context: Context, output: AbstractValue) -> None:
        kind, picture = self._kind(context), output.get_mutable_value().mutable_data
        if kind == FROZEN and context.get_abstract_state(int(self._is_frozen)).get_value():
            picture[:] = context.get_abstract_state(int(self._frozen)).get_value().data
        elif kind == COVERED:
            picture[:] = 0
        else:
            picture[:] = self._image.Eval(context).data
            if kind == DARKENED:
                picture[:, :, :3] = BRIGHTNESS * picture[:, :, :3]
        picture[:, :, 3] = 255

"""What every section of the configuration is made of."""

from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler, ValidationError
from pydantic_core import CoreSchema, core_schema

from holdfast.errors import ConfigError


def quantity(unit: str, default: Any = ..., *, doc: str, **bounds: float) -> Any:
    """A field with a unit: `quantity("m/s^2", 3.0, gt=0, doc="...")`."""
    return Field(default, description=doc, json_schema_extra={"unit": unit}, **bounds)  # type: ignore[call-overload]


def _without_zero(factors: tuple[float, float, float]) -> tuple[float, float, float]:
    if not all(factors):
        raise ValueError("must not hold 0: what an axis says would be lost")
    return factors


Vector3 = Annotated[tuple[float, float, float], Field(description="x, y, z")]
Factors = Annotated[Vector3, AfterValidator(_without_zero)]
Topic = Annotated[str, Field(min_length=1, description="topic in the recording, or the CSV file's stem")]


class Section(BaseModel):
    """Base of all sections: immutable, unknown keys and NaN refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __init__(self, /, **data: Any) -> None:
        """Make a section of plain data or other sections.

        Raises:
            ConfigError: the data break the model's rules, one line each.
        """
        try:
            super().__init__(**data)
        except ValidationError as error:
            from holdfast.config.faults import faults_in_words  # which asks this model

            raise ConfigError(faults_in_words(type(self), data, error)) from None

    # pydantic's own mark of an `__init__` that adds nothing: validation of a file goes past it
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]


class OpenUnion:
    """A section of one of several kinds, to which others can be added: its `kind` names one of `kinds`."""

    kinds: ClassVar[dict[str, type[Section]]]

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema of a union with `kind` as its tag; models that use it are rebuilt when a kind is added."""
        return core_schema.tagged_union_schema({name: handler(section) for name, section in cls.kinds.items()}, "kind")

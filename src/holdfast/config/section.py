"""What every section of the configuration is made of."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


def quantity(unit: str, default: Any = ..., *, doc: str, **bounds: float) -> Any:
    """A field with a unit: `quantity("m/s^2", 3.0, gt=0, doc="...")`."""
    return Field(default, description=doc, json_schema_extra={"unit": unit}, **bounds)  # type: ignore[call-overload]


Vector3 = Annotated[tuple[float, float, float], Field(description="x, y, z")]
Topic = Annotated[str, Field(min_length=1, description="topic in the recording, or the CSV file's stem")]


class Section(BaseModel):
    """Base of all sections: immutable, unknown keys and NaN refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

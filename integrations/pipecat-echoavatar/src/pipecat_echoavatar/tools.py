"""The avatar's tools in Pipecat's forms. All are silent: the model need not say anything about a gesture's result."""

from collections.abc import Awaitable, Callable

from pipecat.adapters.llm.schemas.direct_function import tool_options
from pipecat.adapters.llm.schemas.function_schema import FunctionSchema
from pipecat.frames.frames import FunctionCallResultProperties
from pipecat.services.llm_service import FunctionCallParams

from echoavatar.integrations import StageTools

DirectFunction = Callable[..., Awaitable[None]]


def function_schemas(tools: StageTools) -> list[FunctionSchema]:
    """The registry's schemas, enums included, each with the handler that carries it out."""
    return [
        FunctionSchema(
            name=schema["name"],
            description=schema["description"],
            properties=schema["parameters"].get("properties", {}),
            required=schema["parameters"].get("required", []),
            handler=_handler(tools),
        )
        for schema in tools.schemas
    ]


def direct_functions(tools: StageTools) -> list[DirectFunction]:
    """The registry as direct functions. Pipecat reads their signatures, which cannot list values: docstrings do."""

    async def send_action(
        params: FunctionCallParams,
        action: str,
        intensity: float = 1.0,
        hold: float = 0.0,
    ) -> None:
        given = {"action": action, "intensity": intensity, "hold": hold or None}
        await _answer(params, await tools.call("send_action", given))

    async def play_music(params: FunctionCallParams, title: str = "") -> None:
        await _answer(params, await tools.call("play_music", {"title": title or None}))

    async def stop_music(params: FunctionCallParams) -> None:
        await _answer(params, await tools.call("stop_music", {}))

    async def list_actions(params: FunctionCallParams) -> None:
        await _answer(params, await tools.call("list_actions", {}))

    known = {schema["name"]: schema for schema in tools.schemas}
    functions = []
    for function in (send_action, play_music, stop_music, list_actions):
        schema = known.get(function.__name__)
        if schema is not None:
            function.__doc__ = _docstring(schema["description"], schema["parameters"].get("properties", {}))
            functions.append(tool_options(function, cancel_on_interruption=False))
    return functions


def _docstring(description: str, properties: dict[str, dict[str, object]]) -> str:
    lines = [description]
    if properties:
        lines += ["", "Args:"]
    for name, schema in properties.items():
        choices = schema.get("enum")
        one_of = f" One of: {', '.join(map(str, choices))}." if isinstance(choices, list) else ""
        lines.append(f"    {name}: {schema.get('description', '')}{one_of}")
    return "\n".join(lines)


def _handler(tools: StageTools) -> Callable[[FunctionCallParams], Awaitable[None]]:
    async def handle(params: FunctionCallParams) -> None:
        await _answer(params, await tools.call(params.function_name, params.arguments))

    handler: Callable[[FunctionCallParams], Awaitable[None]] = tool_options(
        handle, cancel_on_interruption=False
    )
    return handler


async def _answer(params: FunctionCallParams, result: dict[str, object]) -> None:
    """The model hears of it, and is asked to speak only where there is something to say."""
    is_silent = result.get("status") in ("accepted", "done")
    properties = FunctionCallResultProperties(run_llm=False) if is_silent else None
    await params.result_callback(result, properties=properties)

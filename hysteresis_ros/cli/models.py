"""``hysteresis models``: which models can be identified, their parameters, units, options and inverses."""

from __future__ import annotations

import click


@click.command(short_help="List the models with parameters, units and inverses.")
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def models(name, as_json):
    """Print all models, or all about the model NAME."""
    from hysteresis_ros.identification.registry import MODELS, find_model

    chosen = {name: find_model(name)} if name else MODELS
    if as_json:
        import json

        click.echo(json.dumps({key: _entry(key, model) for key, model in chosen.items()}, indent=2, ensure_ascii=False))
        return
    click.echo("\n".join(line for key, model in chosen.items() for line in _lines(key, model, bool(name))))


def _entry(name, model) -> dict:
    return {
        "title": model.title,
        "data": model.data,
        "inverses": list(model.inverses),
        "linear": ["auto", "none", *model.linear],
        "parameters": [
            {"name": row.name, "unit": row.unit, "type": row.type_name, "description": row.description}
            for row in model.parameters(name)
        ],
        "options": {key: option.description for key, option in model.options.items()},
    }


def _lines(name, model, whole):
    from hysteresis_ros.identification.linear_stage import STAGES

    yield f"{name}: {model.title}"
    yield f"  data      {model.data}"
    yield f"  inverse   {', '.join(model.inverses)}"
    if model.linear:
        yield f"  linear    {', '.join(('auto', 'none', *model.linear))}"
    yield "  parameters"
    for row in model.parameters(name):
        unit = f" [{row.unit}]" if row.unit else ""
        yield f"    {row.name}{unit}: {row.description}"
    if model.options:
        yield "  options (-p NAME=VALUE)"
        for key, option in model.options.items():
            choices = f" ({', '.join(option.choices)})" if option.choices else ""
            yield f"    {key}: {option.description}{choices}"
    if whole and model.linear:
        yield "  linear stages"
        for key, text in STAGES.items():
            yield f"    {key}: {text}"
    yield ""

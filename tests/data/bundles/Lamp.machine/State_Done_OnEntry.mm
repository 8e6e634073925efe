// nothing to do
{
}
